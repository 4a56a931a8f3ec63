// The scene camera's picture as an eye beside it sees it. CPU twin: src/reference/reproject.rs.

#import camera
#import response

@group(0) @binding(0) var<uniform> camera: Camera;
// A pinhole.
@group(0) @binding(1) var<uniform> eye: Camera;
// xyz: the room's centre, world, metres; w: its radius.
@group(0) @binding(2) var<uniform> room_m: vec4f;
@group(0) @binding(3) var<storage, read> response: array<f32>;
@group(0) @binding(4) var picture: texture_2d<u32>;
// Places of the phantoms that the camera sees, and that the eye sees; w: 0 where there is none.
@group(0) @binding(5) var camera_places: texture_2d<f32>;
@group(0) @binding(6) var eye_places: texture_2d<f32>;
@group(0) @binding(7) var out: texture_storage_2d<rgba8uint, write>;

// How far the colour of something hidden is fetched from, pixels.
const REACH_PX: i32 = 48;

// Unit direction of a pixel of the eye, world.
fn eye_ray(pixel: vec2f) -> vec3f {
    let in_eye = vec3f((pixel - eye.focal_and_principal_px.zw) / eye.focal_and_principal_px.xy, 1.0);
    // The transpose of a rotation is its inverse.
    return normalize((vec4f(in_eye, 0.0) * eye.camera_from_world).xyz);
}

// What the eye sees where no phantom is: the room's sphere from within; from without, something as far away.
fn room_point(origin: vec3f, direction: vec3f) -> vec3f {
    let from_center = origin - room_m.xyz;
    let along = dot(from_center, direction);
    let rest = room_m.w * room_m.w - dot(from_center, from_center);
    if rest <= 0.0 {
        return origin + direction * room_m.w;
    }
    return origin + direction * (sqrt(along * along + rest) - along);
}

// Whether a phantom that the camera's pixel shows stands before a point `depth_m` away along its axis.
fn shows_before(pixel: vec2i, depth_m: f32) -> bool {
    let found = textureLoad(camera_places, pixel, 0);
    let found_m = dot(camera.camera_from_world * vec4f(found.xyz, 1.0), vec4f(0.0, 0.0, 1.0, 0.0));
    return found.w > 0.0 && found_m < 0.99 * depth_m - 0.004;
}

// Whether the camera's pixel shows something before such a point, or is mixed with what does: at an outline the lens spreads
// it over the pixel beside it. Eyes are beside the camera, so what is left and right of the pixel counts.
fn is_before(pixel: vec2i, depth_m: f32) -> bool {
    return shows_before(pixel, depth_m) || shows_before(pixel - vec2i(1, 0), depth_m)
        || shows_before(pixel + vec2i(1, 0), depth_m);
}

// Linear signal of a pixel, as it would be in the middle of the picture.
fn signal(pixel: vec2i) -> vec3f {
    let code = textureLoad(picture, pixel, 0).rgb;
    return vec3f(response[code.r], response[code.g], response[code.b]) / vignetting(camera, vec2f(pixel));
}

// Signal of the nearest pixel, in eight directions, that shows nothing before a point `depth_m` away.
fn nearest_visible(pixel: vec2i, depth_m: f32, size: vec2i) -> vec3f {
    for (var r = 1; r <= REACH_PX; r++) {
        for (var i = 0; i < 9; i++) {
            let at = pixel + r * vec2i(i % 3 - 1, i / 3 - 1);
            if all(at >= vec2i(0)) && all(at < size) && !is_before(at, depth_m) {
                return signal(at);
            }
        }
    }
    return signal(pixel);
}

// Signal at a place in the picture, from the pixels around it that show nothing before a point `depth_m` away.
fn visible_signal(pixel: vec2f, depth_m: f32) -> vec3f {
    let size = vec2i(textureDimensions(picture));
    let corner = floor(pixel);
    let part = pixel - corner;
    var sum = vec4f(0.0);
    for (var i = 0; i < 4; i++) {
        let offset = vec2i(i % 2, i / 2);
        let at = clamp(vec2i(corner) + offset, vec2i(0), size - 1);
        let weights = select(1.0 - part, part, offset == vec2i(1));
        if weights.x * weights.y > 0.0 && !is_before(at, depth_m) {
            sum += weights.x * weights.y * vec4f(signal(at), 1.0);
        }
    }
    if sum.w > 0.0 {
        return sum.rgb / sum.w;
    }
    return nearest_visible(clamp(vec2i(round(pixel)), vec2i(0), size - 1), depth_m, size);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(eye_places)) {
        return;
    }
    let place = textureLoad(eye_places, at.xy, 0);
    var point = place.xyz;
    if place.w == 0.0 {
        point = room_point(eye.position_m.xyz, eye_ray(vec2f(at.xy)));
    }
    let in_camera = (camera.camera_from_world * vec4f(point, 1.0)).xyz;
    var codes = vec3u(0u);
    if is_imaged(camera, in_camera) {
        let pixel = pixel_of(camera, in_camera);
        if all(pixel >= vec2f(-0.5)) && all(pixel <= camera.limits.zw - 0.5) {
            let y = visible_signal(pixel, in_camera.z);
            codes = vec3u(encode(y.r), encode(y.g), encode(y.b));
        }
    }
    textureStore(out, at.xy, vec4u(codes, 255u));
}
