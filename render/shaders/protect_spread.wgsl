// From cells to pixels: the light of bright lights that the prediction has and the picture has not, and what virtual objects
// would take of it a second time. Two places to look: cells that lie in an unknown shadow, and the edges of known ones, which
// the picture has sharper and elsewhere than the prediction.

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
// Cells along the edge of a workgroup's surroundings: those of its 8 × 8 pixels, and so many more to either side.
const AROUND: i32 = 8;
// Share of the believing among them from which they count, and from which they are believed.
const FEW: f32 = 0.08;
const ENOUGH: f32 = 0.25;
// Of the light that is missing at a pixel, so much may be the surface's pattern.
const PATTERN: f32 = 0.15;
// The bright lights' share changes by more where the edge of a known shadow is near.
const EDGE: f32 = 0.15;

var<workgroup> around: array<Cell, 64>;
var<workgroup> said: array<vec4f, 64>;
// Whether anything is to be found here: believing cells, thousandths of the bright lights' most share, and of what the least
// leaves (workgroup memory starts at 0).
var<workgroup> n_believing: atomic<u32>;
var<workgroup> most_lit: atomic<u32>;
var<workgroup> most_unlit: atomic<u32>;

fn mean(rgb: vec3f) -> f32 {
    return dot(rgb, vec3f(1.0 / 3.0));
}

fn square(v: vec2f) -> f32 {
    return dot(v, v);
}

// Brings the cells around a workgroup in, one per thread; the cell that is `REACH` left and above of its first is number 0.
fn gather(group: vec2u, thread: u32) {
    let grid = vec2i((textureDimensions(places) + CELL_PX - 1u) / CELL_PX);
    let other = vec2i(2u * group) - REACH + vec2i(i32(thread) % AROUND, i32(thread) / AROUND);
    if any(other < vec2i(0)) || any(other >= grid) {
        around[thread].log_reflectance.w = 0.0;
        said[thread] = vec4f(0.0);
        return;
    }
    let index = other.y * grid.x + other.x;
    let cell = cells[index];
    around[thread] = cell;
    said[thread] = verdicts[index].shaded;
    if said[thread].w > 0.0 {
        atomicAdd(&n_believing, 1u);
    }
    if cell.log_reflectance.w > 0.0 {
        let thousandths = u32(1000.0 * clamp(mean(cell.share.rgb), 0.0, 1.0));
        atomicMax(&most_lit, thousandths);
        atomicMax(&most_unlit, 1000u - thousandths);
    }
}

fn is_anything_here() -> bool {
    let spread = 0.001 * (f32(atomicLoad(&most_lit)) + f32(atomicLoad(&most_unlit))) - 1.0;
    return atomicLoad(&n_believing) > 0u || spread > EDGE;
}

// A pixel as the mask sees it.
struct Here {
    // Its cell's place in the surroundings, and its own in that cell, from the middle, in cells.
    home: vec2i,
    in_cell: vec2f,
    place: vec3f,
    normal: vec3f,
    // Logarithm.
    reflectance: vec3f,
    // Of the bright lights in the predicted light.
    share: vec3f,
}

// Whether a cell of the surroundings tells something of a pixel's surface.
fn is_of_surface(cell: Cell, here: Here) -> bool {
    return cell.log_reflectance.w > 0.0 && is_same_plane(here.place, here.normal, cell.place_m.xyz, cell.normal.xyz);
}

// Share of the bright lights that is missing at a pixel of a surface of this reflectance (its logarithm).
fn missing_of(here: Here, reflectance: vec3f) -> f32 {
    return dot(1.0 - exp(here.reflectance - reflectance), vec3f(1.0)) / max(dot(here.share, vec3f(1.0)), 1e-6);
}

// Missing share in an unknown shadow (x), and belief in it (y).
fn unknown_shadow(here: Here) -> vec2f {
    var weight = 0.0;
    var believed = 0.0;
    var sum = 0.0;
    for (var i = 0; i < (2 * REACH + 1) * (2 * REACH + 1); i++) {
        let offset = vec2i(i % (2 * REACH + 1), i / (2 * REACH + 1)) - REACH;
        let index = (here.home.y + offset.y) * AROUND + here.home.x + offset.x;
        if !is_of_surface(around[index], here) {
            continue;
        }
        let closeness = exp(-0.35 * square(vec2f(offset) - here.in_cell));
        weight += closeness;
        let shaded = said[index];
        if shaded.w > 0.0 {
            believed += closeness * shaded.w;
            sum += closeness * shaded.w * clamp(missing_of(here, shaded.xyz), 0.0, 1.0);
        }
    }
    if believed <= 0.0 {
        return vec2f(0.0);
    }
    let shown = clamp((sum / believed - PATTERN) / (1.0 - 2.0 * PATTERN), 0.0, 1.0);
    return vec2f(shown, smoothstep(FEW, ENOUGH, believed / weight));
}

// Missing share at the edge of a known shadow; below 0 where the picture has more than the prediction.
fn known_edge(here: Here) -> f32 {
    var least = 1.0;
    var most = 0.0;
    for (var i = 0; i < 9; i++) {
        let index = (here.home.y + i / 3 - 1) * AROUND + here.home.x + i % 3 - 1;
        if is_of_surface(around[index], here) {
            let share = mean(around[index].share.rgb);
            least = min(least, share);
            most = max(most, share);
        }
    }
    if most - least < EDGE {
        return 0.0;
    }
    // The surface's reflectance, from cells that are not on the edge themselves.
    var weight = 0.0;
    var sum = vec3f(0.0);
    for (var i = 0; i < (2 * REACH + 1) * (2 * REACH + 1); i++) {
        let offset = vec2i(i % (2 * REACH + 1), i / (2 * REACH + 1)) - REACH;
        let index = (here.home.y + offset.y) * AROUND + here.home.x + offset.x;
        if !is_of_surface(around[index], here) {
            continue;
        }
        let share = mean(around[index].share.rgb);
        let from_edge = max(min(share - least, most - share), 0.0) / (most - least);
        let trust = exp(-0.2 * square(vec2f(offset) - here.in_cell) - 40.0 * from_edge * from_edge);
        weight += trust;
        sum += trust * around[index].log_reflectance.xyz;
    }
    if weight < 0.1 {
        return 0.0;
    }
    return clamp(missing_of(here, sum / weight), -1.0, 1.0);
}

// Share of the bright lights that is missing at a pixel.
fn missing(at: vec2u, home: vec2i, place: vec3f) -> f32 {
    let in_cell = (vec2f(at % CELL_PX) + 0.5) / f32(CELL_PX) - 0.5;
    let normal = textureLoad(normals, at, 0).xyz;
    let near = near_irradiance(nearest_environment(place, frame.counts.x), normal);
    let pixel = phantom_pixel(at, near);
    let share = pixel.bright / max(pixel.irradiance, vec3f(1e-9));
    if !pixel.is_clear || mean(share) < 0.02 {
        return 0.0;
    }
    let here = Here(home, in_cell, place, normal, log_reflectance(pixel.radiance, pixel.irradiance), share);
    let unknown = unknown_shadow(here);
    return mix(known_edge(here), unknown.x, unknown.y);
}

@compute @workgroup_size(8, 8, 1)
fn main(
    @builtin(global_invocation_id) at: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) thread: u32,
    @builtin(local_invocation_id) local: vec3u,
) {
    gather(group.xy, thread);
    workgroupBarrier();
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var share = 0.0;
    if place.w > 0.0 && is_anything_here() {
        share = missing(at.xy, REACH + vec2i(local.xy / CELL_PX), place.xyz);
    }
    textureStore(absent, at.xy, vec4f(share * textureLoad(light_bright, at.xy, 0).rgb, share));
    textureStore(returned, at.xy, vec4f(share * textureLoad(bright_lost, at.xy, 0).rgb, share));
}
