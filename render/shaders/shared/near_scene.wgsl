// Bindings 4 to 13 of the passes that follow light from near things (src/passes/near_light.rs).

@group(0) @binding(4) var<uniform> camera: Camera;
@group(0) @binding(5) var<uniform> probe: FarLights;
@group(0) @binding(6) var specular: texture_cube_array<f32>;
@group(0) @binding(7) var linear_sampler: sampler;
// The camera's picture as radiance, shadows of virtual objects on it, with mips.
@group(0) @binding(8) var real: texture_2d<f32>;
@group(0) @binding(9) var real_places: texture_2d<f32>;
// Place and normal of the surface that each pixel shows; place's w: 0 where there is none.
@group(0) @binding(10) var places: texture_2d<f32>;
@group(0) @binding(11) var normals: texture_2d<f32>;
@group(0) @binding(12) var out: texture_storage_2d<rgba16float, write>;
// Radiance per vertex of the scene, where real things are.
@group(0) @binding(13) var<storage, read> real_memory: array<vec4f>;
