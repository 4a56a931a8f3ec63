// From cells to pixels: the light of bright lights that the prediction has and the picture has not, and what virtual objects
// would take of it a second time.

#import camera
#import lights
#import sh

#import direct
#import picture
#import protect
#import protect_pixel

@group(0) @binding(14) var<storage, read> cells: array<Cell>;
@group(0) @binding(15) var<storage, read> verdicts: array<Verdict>;
// What virtual objects take of the bright lights.
@group(0) @binding(16) var bright_lost: texture_2d<f32>;
@group(0) @binding(17) var absent: texture_storage_2d<rgba16float, write>;
@group(0) @binding(18) var returned: texture_storage_2d<rgba16float, write>;

// Cells to either side that have a say.
const REACH: i32 = 3;
// Share of the believing among them from which they count, and from which they are believed.
const FEW: f32 = 0.08;
const ENOUGH: f32 = 0.25;
// Of the light that is missing at a pixel, so much may be the surface's pattern.
const PATTERN: f32 = 0.15;

// Share of the bright lights that is missing at a pixel.
fn missing(at: vec2u, place: vec3f, normal: vec3f) -> f32 {
    let near = near_irradiance(nearest_environment(place, frame.counts.x), normal);
    let pixel = phantom_pixel(at, near);
    let share = pixel.bright / max(pixel.irradiance, vec3f(1e-9));
    if dot(share, vec3f(1.0)) < 0.1 {
        return 0.0;
    }
    let reflectance = log_reflectance(pixel.radiance, pixel.irradiance);
    let size = textureDimensions(places);
    let grid = vec2i((size + CELL_PX - 1u) / CELL_PX);
    let home = vec2i(at / CELL_PX);
    var weight = 0.0;
    var believed = 0.0;
    var sum = 0.0;
    for (var dy = -REACH; dy <= REACH; dy++) {
        for (var dx = -REACH; dx <= REACH; dx++) {
            let other = home + vec2i(dx, dy);
            if any(other < vec2i(0)) || any(other >= grid) {
                continue;
            }
            let index = other.y * grid.x + other.x;
            let cell = cells[index];
            if cell.log_reflectance.w == 0.0 || !is_same_plane(place, normal, cell.place.xyz, cell.normal.xyz) {
                continue;
            }
            let closeness = exp(-0.25 * f32(dx * dx + dy * dy));
            weight += closeness;
            let shaded = verdicts[index].shaded;
            if shaded.w > 0.0 {
                let lost = (1.0 - exp(reflectance - shaded.xyz)) * pixel.irradiance / max(pixel.bright, vec3f(1e-9));
                let share_lost = clamp(dot(lost, share) / dot(share, vec3f(1.0)), 0.0, 1.0);
                believed += closeness * shaded.w;
                sum += closeness * shaded.w * share_lost;
            }
        }
    }
    if believed <= 0.0 {
        return 0.0;
    }
    let shown = clamp((sum / believed - PATTERN) / (1.0 - 2.0 * PATTERN), 0.0, 1.0);
    return shown * smoothstep(FEW, ENOUGH, believed / weight);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var share = 0.0;
    if place.w > 0.0 {
        share = missing(at.xy, place.xyz, textureLoad(normals, at.xy, 0).xyz);
    }
    textureStore(absent, at.xy, vec4f(share * textureLoad(light_bright, at.xy, 0).rgb, share));
    textureStore(returned, at.xy, vec4f(share * textureLoad(bright_lost, at.xy, 0).rgb, share));
}
