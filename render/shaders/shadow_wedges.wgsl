// Soft shadow of a rectangular light: how much of it the casters' outlines cover, as every pixel sees it.
//
// The light's frame: x and y on the rectangle (0 ..= 1 each when areas are summed; 32 columns and one unit a line, sheared
// so that lines of samples are horizontal, when samples are counted), z in metres off its plane towards what it lights.
//
// Every outline's edge is projected from the pixel's place onto the light. What lies right of it, on its line of samples,
// gains or loses a layer of shadow, so the sum over all edges is the number of layers before each sample (Laine, Aila,
// Assarsson, Lehtinen, Akenine-Moeller 2005, "Soft shadow volumes for ray tracing"). Where a caster reaches past the
// pixel's place or the light it is cut there, and the cut is an edge like any other.

#import wedge

struct WedgeFrame {
    light_from_world: mat4x4f,
    // xyz: the eye; w: how far places are moved towards it, off their surface, metres.
    eye_m: vec4f,
    // Middle of the light.
    center_m: vec4f,
    half_u_m: vec4f,
    half_v_m: vec4f,
    // x: number of shapes; y: N_LINES, as a number that compilers do not know, lest they write out every line.
    counts: vec4u,
}

@group(0) @binding(0) var<uniform> frame: WedgeFrame;
@group(0) @binding(1) var<storage, read> shapes: array<WedgeShape>;
@group(0) @binding(2) var<storage, read> placed: array<vec4f>;
@group(0) @binding(3) var<storage, read> planes: array<vec4f>;
// Lower and higher corner, face that runs from the lower to the higher, face that runs back; NONE for no face.
@group(0) @binding(4) var<storage, read> edges: array<vec4u>;
@group(0) @binding(5) var<storage, read> faces: array<vec4u>;
@group(0) @binding(6) var places: texture_2d<f32>;
@group(0) @binding(7) var normals: texture_2d<f32>;
@group(0) @binding(8) var visibility: texture_storage_2d<rgba16float, write>;

// 1: areas are summed and outlines are those that the light's middle sees (Assarsson, Akenine-Moeller 2003); 0: samples are
// counted and outlines are those that the pixel's place sees.
override sums_areas: u32 = 0u;

const NONE = 0xffffffffu;
const N_LINES = 16u;
const N_COLUMNS = 32u;
// Bits of a sample's layers; a sample behind exactly 64 layers would seem lit.
const N_BITS = 6u;
// Casters count from this share of the way from the light, to as far before the pixel's place.
const CLEARANCE = 1e-4;
const N_THREADS = 64u;
// Candidates that a tile looks at before it draws those that matter.
const BATCH = 256u;
// Entries of the list: an index; four more than an edge's weight (-2 to 2) where it is the same in all of
// the tile, else 7; flags. No entry is 0.
const INDEX = 0x07ffffffu;
const WEIGHT_SHIFT = 27u;
const UNWEIGHED = 0x38000000u;
const OPEN = 0x40000000u;
const FACE = 0x80000000u;

var<workgroup> lows: array<vec3f, N_THREADS>;
var<workgroup> highs: array<vec3f, N_THREADS>;
var<workgroup> tile_low: vec3f;
var<workgroup> tile_high: vec3f;
var<workgroup> n_kept: atomic<u32>;
var<workgroup> kept: array<u32, BATCH>;

// The pixel's place in the light's frame.
var<private> place: vec3f;
// Layers before each sample: bit b of line i in word i * N_BITS + b, a sample's column is its bit in the word.
var<private> layers: array<u32, N_LINES * N_BITS>;
// Covered share of the light, layers apart.
var<private> area: f32;

fn extent() -> vec2f {
    return select(vec2f(f32(N_COLUMNS), f32(N_LINES) - 1.0), vec2f(1.0), sums_areas == 1u);
}

// How far samples of a line stand right of their column: different in every line.
fn phase(line: u32) -> f32 {
    return (f32(reverseBits(line) >> 28u) + 0.5) / f32(N_LINES);
}

// Whose outlines count.
fn viewer() -> vec3f {
    return select(place, vec3f(0.5, 0.5, 0.0), sums_areas == 1u);
}

// Where the viewer stands to a face: 1 before it, 0 behind it, or -1 there where faces block from both sides. The light's
// middle is before a face where the pixel's place is behind it.
fn facing(face: u32, is_open: bool) -> i32 {
    if face == NONE {
        return 0;
    }
    let is_before = (dot(planes[face], vec4f(viewer(), 1.0)) > 0.0) != (sums_areas == 1u);
    return select(select(0, -1, is_open), 1, is_before);
}

// Where the way from the pixel's place through a point meets the light's plane.
fn projected(at: vec3f) -> vec2f {
    return place.xy + (at.xy - place.xy) * (place.z / (place.z - at.z));
}

// Adds `value` to the samples of a line that `columns` has bits for.
fn add(line: u32, columns: u32, value: i32) {
    let bits = bitcast<u32>(value);
    var carry = 0u;
    for (var b = 0u; b < N_BITS; b++) {
        let word = line * N_BITS + b;
        let addend = select(0u, columns, ((bits >> b) & 1u) == 1u);
        let old = layers[word];
        layers[word] = old ^ addend ^ carry;
        carry = (old & addend) | (carry & (old | addend));
    }
}

// Integral of x clamped to 0 ..= 1.
fn clamped_integral(x: f32) -> f32 {
    let inside = clamp(x, 0.0, 1.0);
    return 0.5 * inside * inside + max(x - 1.0, 0.0);
}

// Signed share of the light right of an edge on the light's plane, positive for one that goes down.
fn share_right_of(a: vec2f, b: vec2f) -> f32 {
    let y0 = clamp(a.y, 0.0, 1.0);
    let y1 = clamp(b.y, 0.0, 1.0);
    if y0 == y1 {
        return 0.0;
    }
    let slope = (b.x - a.x) / (b.y - a.y);
    let x0 = a.x + (y0 - a.y) * slope;
    let x1 = a.x + (y1 - a.y) * slope;
    var mean = clamp(0.5 * (x0 + x1), 0.0, 1.0);
    if abs(x1 - x0) > 1e-3 {
        mean = (clamped_integral(x1) - clamped_integral(x0)) / (x1 - x0);
    }
    return (y0 - y1) * (1.0 - mean);
}

// Puts `weight` layers of shadow left of the way from a to b on the light's plane.
fn add_edge(a: vec2f, b: vec2f, weight: i32) {
    if sums_areas == 1u {
        area += f32(weight) * share_right_of(a, b);
        return;
    }
    let first = u32(clamp(ceil(min(a.y, b.y)), 0.0, f32(N_LINES)));
    let end = u32(clamp(ceil(max(a.y, b.y)), 0.0, f32(N_LINES)));
    let value = select(weight, -weight, b.y > a.y);
    let slope = (b.x - a.x) / (b.y - a.y);
    for (var line = first; line < end; line++) {
        let x = clamp(a.x + (f32(line) - a.y) * slope, min(a.x, b.x), max(a.x, b.x));
        let n_left = u32(clamp(ceil(x - phase(line)), 0.0, f32(N_COLUMNS)));
        if n_left < N_COLUMNS {
            add(line, NONE << n_left, value);
        }
    }
}

// Where the way between two corners crosses a height. The lower corner comes first, so that faces and edges find the same.
fn crossing(first: u32, second: u32, height: f32) -> vec3f {
    let a = placed[min(first, second)].xyz;
    let b = placed[max(first, second)].xyz;
    return vec3f(mix(a.xy, b.xy, (height - a.z) / (b.z - a.z)), height);
}

// A way on the light's plane, and how many layers of shadow are left of it.
struct Span {
    a: vec2f,
    b: vec2f,
    weight: i32,
}

fn edge_span(entry: u32, is_open: bool) -> Span {
    let nothing = Span(vec2f(0.0), vec2f(0.0), 0);
    let edge = edges[entry & INDEX];
    var weight = i32((entry >> WEIGHT_SHIFT) & 7u) - 4;
    if (entry & UNWEIGHED) == UNWEIGHED {
        weight = facing(edge.z, is_open) - facing(edge.w, is_open);
    }
    if weight == 0 {
        return nothing;
    }
    let near = CLEARANCE * place.z;
    let far = (1.0 - CLEARANCE) * place.z;
    var a = placed[edge.x].xyz;
    var b = placed[edge.y].xyz;
    if max(a.z, b.z) < near || min(a.z, b.z) > far {
        return nothing;
    }
    let a_z = a.z;
    let b_z = b.z;
    if a_z < near || a_z > far {
        a = crossing(edge.x, edge.y, select(far, near, a_z < near));
    }
    if b_z < near || b_z > far {
        b = crossing(edge.x, edge.y, select(far, near, b_z < near));
    }
    return Span(projected(a), projected(b), weight);
}

// The cut of a face where casters stop to count: past the pixel's place, or past the light.
fn cut_span(index: u32, is_open: bool, is_past_light: bool) -> Span {
    let weight = facing(index, is_open);
    let face = faces[index].xyz;
    let height = select(1.0 - CLEARANCE, CLEARANCE, is_past_light) * place.z;
    let sign = select(1.0, -1.0, is_past_light);
    let out = vec3<bool>(
        sign * placed[face.x].z > sign * height,
        sign * placed[face.y].z > sign * height,
        sign * placed[face.z].z > sign * height,
    );
    if all(out) || !any(out) || weight == 0 {
        return Span(vec2f(0.0), vec2f(0.0), 0);
    }
    var leaving = vec3f(0.0);
    var entering = vec3f(0.0);
    if out.x != out.y {
        let at = crossing(face.x, face.y, height);
        leaving = select(leaving, at, out.y);
        entering = select(entering, at, out.x);
    }
    if out.y != out.z {
        let at = crossing(face.y, face.z, height);
        leaving = select(leaving, at, out.z);
        entering = select(entering, at, out.y);
    }
    if out.z != out.x {
        let at = crossing(face.z, face.x, height);
        leaving = select(leaving, at, out.x);
        entering = select(entering, at, out.z);
    }
    return Span(projected(leaving), projected(entering), weight);
}

// Adds an edge, or both cuts of a face, from the tile's list.
fn take(entry: u32) {
    let index = entry & INDEX;
    let is_open = (entry & OPEN) != 0u;
    let is_face = (entry & FACE) != 0u;
    for (var part = 0u; part < select(1u, 2u, is_face); part++) {
        var span: Span;
        if is_face {
            span = cut_span(index, is_open, part == 1u);
        } else {
            span = edge_span(entry, is_open);
        }
        if span.weight != 0 {
            add_edge(span.a, span.b, span.weight);
        }
    }
}

// Least and greatest product of two intervals.
fn product(a: vec2f, b: vec2f) -> vec2f {
    let all = vec4f(a.x * b, a.y * b);
    return vec2f(min(min(all.x, all.y), min(all.z, all.w)), max(max(all.x, all.y), max(all.z, all.w)));
}

// Bounds, over the tile, of which side of the plane through a line on the light and the tile's place a box is on: x axis or
// y axis, times the distance of the tile's place. Positive beyond the line.
fn side(axis: u32, line: f32, low: vec3f, high: vec3f) -> vec2f {
    let tile_z = vec2f(tile_low.z, tile_high.z);
    let to_box = product(vec2f(low[axis] - line, high[axis] - line), tile_z);
    let to_tile = product(vec2f(tile_low[axis] - line, tile_high[axis] - line), vec2f(low.z, high.z));
    return vec2f(to_box.x - to_tile.y, to_box.y - to_tile.x);
}

// Whether a box may stand between the tile and the light.
fn is_between(low: vec3f, high: vec3f) -> bool {
    let last = extent();
    return high.z > CLEARANCE * tile_low.z && low.z < tile_high.z
        && side(0u, last.x, low, high).x <= 0.0 && side(0u, 0.0, low, high).y >= 0.0
        && side(1u, last.y, low, high).x <= 0.0 && side(1u, 0.0, low, high).y >= 0.0;
}

// Whether two points are above, below or right of the light, seen from everywhere in the tile: then the way between them
// crosses none of the light's lines left of its end.
fn is_aside(a: vec3f, b: vec3f) -> bool {
    let last = extent();
    return (side(1u, last.y, a, a).x > 0.0 && side(1u, last.y, b, b).x > 0.0)
        || (side(1u, 0.0, a, a).y < 0.0 && side(1u, 0.0, b, b).y < 0.0)
        || (side(0u, last.x, a, a).x > 0.0 && side(0u, last.x, b, b).x > 0.0);
}

// `facing` for all of the tile; UNKNOWN where it is not the same everywhere.
const UNKNOWN = 8;
fn tile_facing(face: u32, is_open: bool) -> i32 {
    if sums_areas == 1u || face == NONE {
        return facing(face, is_open);
    }
    let plane = planes[face];
    let middle = dot(plane, vec4f(0.5 * (tile_low + tile_high), 1.0));
    let reach = 0.5 * dot(abs(plane.xyz), tile_high - tile_low);
    if abs(middle) <= 1.001 * reach {
        return UNKNOWN;
    }
    return select(select(0, -1, is_open), 1, middle > 0.0);
}

// An edge's entry for the list; 0 where it does not matter to the tile.
fn edge_entry(index: u32, flags: u32) -> u32 {
    let edge = edges[index];
    let a = placed[edge.x].xyz;
    let b = placed[edge.y].xyz;
    if max(a.z, b.z) < CLEARANCE * tile_low.z || min(a.z, b.z) > tile_high.z || is_aside(a, b) {
        return 0u;
    }
    let is_open = (flags & OPEN) != 0u;
    let forward = tile_facing(edge.z, is_open);
    let backward = tile_facing(edge.w, is_open);
    if forward == UNKNOWN || backward == UNKNOWN {
        return index | flags | UNWEIGHED;
    }
    return select(index | flags | (u32(forward - backward + 4) << WEIGHT_SHIFT), 0u, forward == backward);
}

fn is_cut(low: f32, high: f32) -> bool {
    return (low <= CLEARANCE * tile_high.z && high >= CLEARANCE * tile_low.z)
        || (low <= tile_high.z && high >= (1.0 - CLEARANCE) * tile_low.z);
}

fn face_matters(index: u32) -> bool {
    let face = faces[index];
    let a = placed[face.x].xyz;
    let b = placed[face.y].xyz;
    let c = placed[face.z].xyz;
    return is_cut(min(a.z, min(b.z, c.z)), max(a.z, max(b.z, c.z))) && !(is_aside(a, b) && is_aside(b, c) && is_aside(a, c));
}

// Looks through edges (or faces) `first` to `first + n` and draws those that matter to the tile.
fn take_range(first: u32, n: u32, lane: u32, flags: u32) {
    for (var start = 0u; start < n; start += BATCH) {
        for (var i = start + lane; i < min(start + BATCH, n); i += N_THREADS) {
            var entry = 0u;
            if (flags & FACE) == 0u {
                entry = edge_entry(first + i, flags);
            } else if face_matters(first + i) {
                entry = (first + i) | flags;
            }
            if entry != 0u {
                kept[atomicAdd(&n_kept, 1u)] = entry;
            }
        }
        workgroupBarrier();
        let n_now = atomicLoad(&n_kept);
        if place.z > 0.0 {
            for (var i = 0u; i < n_now; i++) {
                take(kept[i]);
            }
        }
        workgroupBarrier();
        if lane == 0u {
            atomicStore(&n_kept, 0u);
        }
        workgroupBarrier();
    }
}

// A place on the light, 0 ..= 1 along both sides.
fn on_light(x: f32, y: f32) -> vec3f {
    return frame.center_m.xyz + (2.0 * x - 1.0) * frame.half_u_m.xyz + (2.0 * y - 1.0) * frame.half_v_m.xyz;
}

// Share of the light that arrives, by what the visible samples would give the surface.
fn lit_share(place_m: vec3f, normal: vec3f, is_uneven: bool) -> f32 {
    // Where all of the light gives about the same, eight samples of a line are taken together.
    let n_together = select(8u, 1u, is_uneven);
    let middle = 0.5 * f32(n_together - 1u);
    var arriving = 0.0;
    var all = 0.0;
    for (var line = 0u; line < frame.counts.y; line++) {
        var covered = 0u;
        for (var b = 0u; b < N_BITS; b++) {
            covered |= layers[line * N_BITS + b];
        }
        for (var column = 0u; column < N_COLUMNS; column += n_together) {
            let x = (f32(column) + middle + phase(line)) / f32(N_COLUMNS);
            let way = on_light(x, (f32(line) + x) / f32(N_LINES)) - place_m;
            let squared = dot(way, way);
            let weight = max(dot(way, normal), 0.0) / (squared * squared);
            let lit = ~covered & ((0xffu >> (8u - n_together)) << column);
            all += weight;
            arriving += weight * f32(countOneBits(lit)) / f32(n_together);
        }
    }
    return select(1.0, arriving / all, all > 0.0);
}

// The share of the light that arrives at the pixel.
fn share(place_m: vec3f, normal: vec3f) -> f32 {
    var heights: vec4f;
    for (var i = 0u; i < 4u; i++) {
        heights[i] = dot(on_light(f32(i & 1u), f32(i >> 1u)) - place_m, normal);
    }
    if all(heights <= vec4f(0.0)) {
        // The surface turns away from the light: no matter what is before it.
        return 1.0;
    }
    if sums_areas == 1u {
        return 1.0 - clamp(area, 0.0, 1.0);
    }
    var any_layer = 0u;
    for (var word = 0u; word < frame.counts.y * N_BITS; word++) {
        any_layer |= layers[word];
    }
    if any_layer == 0u {
        return 1.0;
    }
    let size_m = length(frame.half_u_m.xyz) + length(frame.half_v_m.xyz);
    let is_uneven = any(heights < vec4f(0.0)) || distance(place_m, frame.center_m.xyz) < 2.0 * size_m;
    return lit_share(place_m, normal, is_uneven);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u, @builtin(local_invocation_index) lane: u32) {
    let is_pixel = all(at.xy < textureDimensions(places));
    var place_m = vec4f(0.0);
    var normal = vec3f(0.0);
    place = vec3f(0.0);
    if is_pixel {
        place_m = textureLoad(places, at.xy, 0);
        normal = textureLoad(normals, at.xy, 0).xyz;
        if place_m.w > 0.0 {
            let to_eye = normalize(frame.eye_m.xyz - place_m.xyz);
            place = (frame.light_from_world * vec4f(place_m.xyz + frame.eye_m.w * to_eye, 1.0)).xyz;
        }
    }
    lows[lane] = select(vec3f(3e38), place, place.z > 0.0);
    highs[lane] = select(vec3f(-3e38), place, place.z > 0.0);
    workgroupBarrier();
    if lane == 0u {
        var low = lows[0];
        var high = highs[0];
        for (var i = 1u; i < N_THREADS; i++) {
            low = min(low, lows[i]);
            high = max(high, highs[i]);
        }
        tile_low = low;
        tile_high = high;
    }
    workgroupBarrier();
    if workgroupUniformLoad(&tile_high).z > 0.0 {
        for (var i = 0u; i < frame.counts.x; i++) {
            let low = shapes[i].low;
            let high = shapes[i].high.xyz;
            if !is_between(low.xyz, high) {
                continue;
            }
            let ranges = shapes[i].ranges;
            let open = select(0u, OPEN, low.w > 0.0);
            take_range(ranges.x, ranges.y, lane, open);
            if is_cut(low.z, high.z) {
                take_range(ranges.z, ranges.w, lane, open | FACE);
            }
        }
    }
    if !is_pixel {
        return;
    }
    var arriving = 1.0;
    if place.z > 0.0 {
        arriving = share(place_m.xyz, normal);
    }
    textureStore(visibility, at.xy, vec4f(vec3f(arriving), 1.0));
}
