// Irradiance of rays in the format in which every shadow method gives its light.

@group(0) @binding(0) var traced_without: texture_2d<f32>;
@group(0) @binding(1) var traced_with: texture_2d<f32>;
@group(0) @binding(2) var without: texture_storage_2d<rgba16float, write>;
@group(0) @binding(3) var with_virtual: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if all(at.xy < textureDimensions(traced_without)) {
        textureStore(without, at.xy, textureLoad(traced_without, at.xy, 0));
        textureStore(with_virtual, at.xy, textureLoad(traced_with, at.xy, 0));
    }
}
