// What the camera sees of the phantoms' vertices, as radiance over the irradiance that harmonics give there, averaged over
// frames: so it follows when the light changes.

#import camera
#import lights
#import sh
#import scene_vertex
#import seen

@group(0) @binding(6) var<uniform> camera: Camera;
@group(0) @binding(7) var real_places: texture_2d<f32>;
// The camera's picture as radiance, without virtual shadows, with mips.
@group(0) @binding(8) var unshadowed: texture_2d<f32>;
@group(0) @binding(9) var linear_sampler: sampler;
// rgb: mean of the ratios; a: frames that it is made of, MOST_FRAMES at most.
@group(0) @binding(10) var<storage, read_write> ratios: array<vec4f>;

// A surface must face the camera by this cosine to be taken in.
const LEAST_FACING = 0.2;
// Width of what is looked at, metres: small beside the triangles, wide enough to average the camera's noise.
const FOOTPRINT_M = 0.006;
const MOST_FRAMES = 16.0;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&facts) || facts[id.x].x == NO_PART {
        return;
    }
    let vertex = placed_vertex(id.x);
    let to_eye = normalize(camera.position_m.xyz - vertex.place);
    let pixel = seen_at(vertex.place);
    // An object that is not there has no normals: not a number, which is not at least anything.
    if pixel.x < 0.0 || !(dot(vertex.normal, to_eye) >= LEAST_FACING) {
        return;
    }
    let irradiance = irradiance_at(vertex);
    if min(irradiance.r, min(irradiance.g, irradiance.b)) <= 0.0 {
        return;
    }
    let pixels = FOOTPRINT_M * camera.focal_and_principal_px.x / distance(vertex.place, camera.position_m.xyz);
    let uv = (pixel + 0.5) / camera.limits.zw;
    let radiance = textureSampleLevel(unshadowed, linear_sampler, uv, log2(max(pixels, 1.0))).rgb;
    let before = ratios[id.x];
    let frames = min(before.a + 1.0, MOST_FRAMES);
    ratios[id.x] = vec4f(mix(before.rgb, radiance / irradiance, 1.0 / frames), frames);
}
