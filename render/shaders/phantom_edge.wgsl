// Edges of phantoms before virtual objects: where the picture shows the real thing's own edge beside the mesh's, the picture's
// is taken.

#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> response: array<f32>;
@group(0) @binding(2) var picture: texture_2d<u32>;
// What the camera sees of the phantoms, and of the virtual objects as if no phantom stood before them.
@group(0) @binding(3) var real_places: texture_2d<f32>;
@group(0) @binding(4) var virtual_places: texture_2d<f32>;
// Virtual objects as radiance times coverage, hidden by the meshes.
@group(0) @binding(5) var shaded: texture_2d<f32>;
@group(0) @binding(6) var out: texture_storage_2d<rgba16float, write>;

// A mesh's edge is at most so many pixels off, and what lies farther than that from it is known to be one side or the other.
const OFF_PX: i32 = 2;
// Pixels to either side in which the two sides' colours are looked for.
const REACH_PX: i32 = 6;
// Places of either side that tell a colour.
const LEAST_PLACES: f32 = 4.0;
// The sides' colours lie apart by so many standard deviations, or nothing is changed; and by so many for full belief.
const APART: f32 = 2.5;
const FAR_APART: f32 = 4.0;
// Standard deviation of a pixel's square root of signal that noise alone makes.
const NOISE: f32 = 0.01;
// A phantom hides what is farther away by this, metres.
const BEHIND_M: f32 = 0.001;
// A surface that is bent by more from pixel to pixel ends there, metres; and where no phantom is.
const BEND_M: f32 = 0.004;
const NOWHERE_M: f32 = 1000.0;

fn depth_of(place: vec3f) -> f32 {
    return (camera.camera_from_world * vec4f(place, 1.0)).z;
}

// Depth of the phantom at a pixel, metres.
fn real_depth(at: vec2i) -> f32 {
    let place = textureLoad(real_places, clamp(at, vec2i(0), vec2i(textureDimensions(real_places)) - 1), 0);
    return select(NOWHERE_M, depth_of(place.xyz), place.w > 0.0);
}

// Whether the phantom at a pixel hides what is `depth_m` away.
fn hides(at: vec2i, depth_m: f32) -> bool {
    return real_depth(at) < depth_m - BEHIND_M;
}

// The picture where its noise is even: square root of the linear signal.
fn look(at: vec2i) -> vec3f {
    let code = textureLoad(picture, clamp(at, vec2i(0), vec2i(textureDimensions(picture)) - 1), 0).rgb;
    return sqrt(max(vec3f(response[code.r], response[code.g], response[code.b]), vec3f(0.0)));
}

// Whether between three pixels in a row one hides and one does not, and the phantoms there are not one flat surface: the
// ground before an object's foot hides nothing of it.
fn is_edge(at: vec2i, step: vec2i, depth_m: f32) -> bool {
    let before = real_depth(at - step);
    let here = real_depth(at);
    let after = real_depth(at + step);
    let least = depth_m - BEHIND_M;
    let changes = (before < least) != (here < least) || (after < least) != (here < least);
    return changes && abs(before - 2.0 * here + after) > BEND_M;
}

// Whether a mesh's edge is near.
fn is_near_edge(at: vec2i, depth_m: f32) -> bool {
    for (var step = 1; step <= OFF_PX + 1; step++) {
        if is_edge(at, vec2i(step, 0), depth_m) || is_edge(at, vec2i(0, step), depth_m) {
            return true;
        }
    }
    return false;
}

// Whether a pixel is on its side for certain: a mesh's edge is not near.
fn is_certain(at: vec2i, depth_m: f32, side: bool) -> bool {
    return hides(at + vec2i(OFF_PX, 0), depth_m) == side && hides(at - vec2i(OFF_PX, 0), depth_m) == side
        && hides(at + vec2i(0, OFF_PX), depth_m) == side && hides(at - vec2i(0, OFF_PX), depth_m) == side;
}

struct Side {
    n: f32,
    sum: vec3f,
    squares: f32,
}

fn added(side: Side, weight: f32, color: vec3f) -> Side {
    return Side(side.n + weight, side.sum + weight * color, side.squares + weight * dot(color, color));
}

fn variance(side: Side) -> f32 {
    let mean = side.sum / side.n;
    return max(side.squares / side.n - dot(mean, mean), 0.0);
}

// Share of a pixel that the real thing covers, by the picture (x), and belief in it (y).
fn covered(at: vec2i, depth_m: f32) -> vec2f {
    var front = Side(0.0, vec3f(0.0), 0.0);
    var back = Side(0.0, vec3f(0.0), 0.0);
    for (var dy = -REACH_PX; dy <= REACH_PX; dy++) {
        for (var dx = -REACH_PX; dx <= REACH_PX; dx++) {
            let there = at + vec2i(dx, dy);
            let side = hides(there, depth_m);
            if !is_certain(there, depth_m, side) {
                continue;
            }
            let weight = exp(-0.08 * f32(dx * dx + dy * dy));
            if side {
                front = added(front, weight, look(there));
            } else {
                back = added(back, weight, look(there));
            }
        }
    }
    let least = LEAST_PLACES * exp(-0.08 * 16.0);
    if front.n < least || back.n < least {
        return vec2f(0.0);
    }
    let behind = back.sum / back.n;
    let across = front.sum / front.n - behind;
    let contrast = dot(across, across);
    let spread = sqrt(max(variance(front), variance(back)) + NOISE * NOISE);
    let here = look(at) - behind;
    let along = dot(here, across) / max(contrast, 1e-9);
    // A third colour is neither side's.
    let aside = length(here - clamp(along, 0.0, 1.0) * across);
    let belief = smoothstep(APART, FAR_APART, sqrt(contrast) / spread) * (1.0 - smoothstep(0.3, 0.6, aside / sqrt(max(contrast, 1e-9))));
    return vec2f(clamp(along, 0.0, 1.0), belief);
}

// Radiance of the virtual object at a pixel or, where it is hidden there, beside it.
fn radiance_near(at: vec2i) -> vec4f {
    var sum = vec4f(0.0);
    for (var dy = -OFF_PX - 1; dy <= OFF_PX + 1; dy++) {
        for (var dx = -OFF_PX - 1; dx <= OFF_PX + 1; dx++) {
            let there = clamp(at + vec2i(dx, dy), vec2i(0), vec2i(textureDimensions(shaded)) - 1);
            sum += exp(-1.0 * f32(dx * dx + dy * dy)) * textureLoad(shaded, there, 0);
        }
    }
    return sum;
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(shaded)) {
        return;
    }
    let at = vec2i(id.xy);
    let as_drawn = textureLoad(shaded, at, 0);
    let place = textureLoad(virtual_places, at, 0);
    var refined = as_drawn;
    if place.w > 0.0 {
        let depth_m = depth_of(place.xyz);
        if is_near_edge(at, depth_m) {
            let found = covered(at, depth_m);
            let beside = radiance_near(at);
            if found.y > 0.0 && beside.a > 0.0 {
                let alpha = mix(as_drawn.a, 1.0 - found.x, found.y);
                refined = vec4f(alpha / beside.a * beside.rgb, alpha);
            }
        }
    }
    textureStore(out, at, refined);
}
