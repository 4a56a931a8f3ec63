// A pinhole view (src/shadow/view.rs): depth 0 at the near plane, 1 at infinity.
struct View {
    clip_from_world: mat4x4f,
    world_from_clip: mat4x4f,
    eye_m: vec4f,
    size_px: vec4f,
}
