// Radiance of every phantom's vertex in the light of now: what the camera saw of it, else the probe's picture where the probe
// sees it, else what the rest of the part sends on average.

#import lights
#import sh
#import scene_vertex

@group(0) @binding(6) var<uniform> probe: ProbePlace;
@group(0) @binding(7) var probe_radiance: texture_cube<f32>;
@group(0) @binding(8) var linear_sampler: sampler;
@group(0) @binding(9) var<storage, read> ratios: array<vec4f>;
@group(0) @binding(10) var<storage, read> means: array<vec4f>;
@group(0) @binding(11) var<storage, read_write> remembered: array<vec4f>;

// The head of `FarLights` in `shared/far_lights.wgsl`.
struct ProbePlace {
    position_m: vec4f,
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&facts) || facts[id.x].x == NO_PART {
        return;
    }
    let vertex = placed_vertex(id.x);
    let mean = means[facts[id.x].x];
    var ratio = ratios[id.x];
    if ratio.a == 0.0 && facts[id.x].y == 0u {
        ratio = mean;
    }
    var radiance = ratio.rgb * irradiance_at(vertex);
    if ratio.a == 0.0 {
        radiance = textureSampleLevel(probe_radiance, linear_sampler, vertex.place - probe.position_m.xyz, 0.0).rgb;
    }
    remembered[id.x] = vec4f(radiance, 1.0);
}
