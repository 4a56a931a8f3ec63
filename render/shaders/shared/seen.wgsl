// Whether a camera sees a point on a real surface. The importing shader declares `camera` and `real_places`, the places of
// the phantoms that the camera sees (w: 0 where there is none).

// Pixel that shows a point, or a negative one where something stands before it or it is out of the picture.
fn seen_at(point: vec3f) -> vec2f {
    let in_camera = (camera.camera_from_world * vec4f(point, 1.0)).xyz;
    if !is_imaged(camera, in_camera) {
        return vec2f(-1.0);
    }
    let pixel = pixel_of(camera, in_camera);
    if any(pixel < vec2f(0.0)) || any(pixel > camera.limits.zw - 1.0) {
        return vec2f(-1.0);
    }
    let found = textureLoad(real_places, vec2i(round(pixel)), 0);
    let seen_m = dot(camera.camera_from_world * vec4f(found.xyz, 1.0), vec4f(0.0, 0.0, 1.0, 0.0));
    let is_seen = found.w > 0.0 && abs(seen_m - in_camera.z) < 0.004 + 0.01 * in_camera.z;
    return select(vec2f(-1.0), pixel, is_seen);
}
