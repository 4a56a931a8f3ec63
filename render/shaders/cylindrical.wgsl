// One of three steps of the cylindrical filter (Supan 2006, 3.4.1, after Lander): the mean of a cube that is turned about
// an axis by little steps. CPU twin: src/reference/cylindrical.rs.

#import cube

struct Turn {
    // xyz: axis; w: factor of the result.
    axis: vec4f,
    // x: angle that is swept, radians; y: number of steps.
    sweep: vec4f,
}

@group(0) @binding(0) var<uniform> turn: Turn;
@group(0) @binding(1) var source: texture_cube<f32>;
@group(0) @binding(2) var linear_sampler: sampler;
@group(0) @binding(3) var out: texture_storage_2d_array<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = textureDimensions(out).x;
    if any(texel.xy >= vec2u(size)) {
        return;
    }
    let direction = texel_direction(size, texel, vec2f(0.5));
    let axis = turn.axis.xyz;
    let along = axis * dot(axis, direction);
    let across = direction - along;
    let beside = cross(axis, direction);
    let n = u32(turn.sweep.y);
    var sum = vec3f(0.0);
    for (var i = 0u; i < n; i++) {
        let angle = turn.sweep.x * ((f32(i) + 0.5) / f32(n) - 0.5);
        sum += textureSampleLevel(source, linear_sampler, along + across * cos(angle) + beside * sin(angle), 0.0).rgb;
    }
    let mean = sum * (turn.axis.w / f32(n));
    textureStore(out, texel.xy, texel.z, vec4f(min(mean, vec3f(60000.0)), 1.0));
}
