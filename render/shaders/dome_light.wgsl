// Irradiance of all lights of a dome past the shadows that the bits tell.

#import dome

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> bits: array<u32>;
@group(0) @binding(5) var irradiance: texture_storage_2d<rgba16float, write>;

// Pixels of a thread, one below the other: loading a light costs more than using it.
const ROWS: u32 = 4u;

@compute @workgroup_size(8, 4, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    var place: array<vec4f, 4>;
    var normal: array<vec3f, 4>;
    var sum: array<vec3f, 4>;
    var mask: array<u32, 4>;
    if id.x >= frame.sizes.y {
        return;
    }
    for (var row = 0u; row < ROWS; row++) {
        let at = vec2u(id.x, id.y * ROWS + row);
        place[row] = vec4f(0.0);
        if at.y < frame.sizes.z {
            place[row] = textureLoad(places, at, 0);
            normal[row] = textureLoad(normals, at, 0).xyz;
        }
        // Light from above alone, where `w` says so, is seen by as much of a tilted surface.
        let share = mix(1.0, 0.5 + 0.5 * normal[row].z, frame.ambient.w);
        sum[row] = share * frame.ambient.rgb;
    }
    let n_pixels = frame.sizes.y * frame.sizes.z;
    for (var i = 0u; i < frame.counts.x; i++) {
        if (i & 31u) == 0u {
            for (var row = 0u; row < ROWS; row++) {
                if place[row].w > 0.0 {
                    mask[row] = bits[(i / 32u) * n_pixels + (id.y * ROWS + row) * frame.sizes.y + id.x];
                }
            }
        }
        let position_m = lights[i].position_m.xyz;
        let intensity = lights[i].intensity.rgb;
        for (var row = 0u; row < ROWS; row++) {
            let share = unshadowed(position_m, place[row].xyz, normal[row]) * f32(mask[row] & 1u);
            sum[row] += intensity * share;
            mask[row] >>= 1u;
        }
    }
    for (var row = 0u; row < ROWS; row++) {
        let at = vec2u(id.x, id.y * ROWS + row);
        if at.y < frame.sizes.z {
            textureStore(irradiance, at, vec4f(sum[row], 1.0) * place[row].w);
        }
    }
}
