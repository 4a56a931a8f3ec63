// What rays that leave virtual objects need to know of them, per pixel: the normals of mesh and substance, roughness,
// glass.

#import camera
#import lights

#import material

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

struct Corner {
    @invariant @builtin(position) clip: vec4f,
    @location(0) place: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) @interpolate(flat) object: u32,
    @location(4) @interpolate(flat) material: u32,
    @location(5) uv1: vec2f,
    @location(6) tangent: vec4f,
    @location(7) color: vec4f,
}

struct Targets {
    // xyz: unit normal, normal map included, on the eye's side; w: perceptual roughness.
    @location(0) gloss: vec4f,
    // xyz: unit normal of the mesh, on the eye's side; w: index of the object, from 1.
    @location(1) shape: vec4f,
    // x: share that is neither reflected nor absorbed nor scattered, times 1 less metallic; y: index of refraction; z: the
    // material's thickness in metres, 0 for a thin wall.
    @location(2) glass: vec4f,
}

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @location(2) normal: vec3f,
    @location(3) material: u32,
    @location(4) uv: vec2f,
    @location(5) uv1: vec2f,
    @location(6) tangent: vec4f,
    @location(7) color: vec4f,
) -> Corner {
    let world_from_object = objects[object].world_from_object;
    let place = (world_from_object * vec4f(position, 1.0)).xyz;
    let direction = (world_from_object * vec4f(normal, 0.0)).xyz;
    let along = (world_from_object * vec4f(tangent.xyz, 0.0)).xyz;
    return Corner(clip_of(camera, place), place, direction, uv, object, material, uv1, vec4f(along, tangent.w), color);
}

@fragment
fn fragment(corner: Corner, @builtin(front_facing) is_front: bool) -> Targets {
    let spread = vec2f(
        max(length(dpdx(corner.uv)), length(dpdy(corner.uv))),
        max(length(dpdx(corner.uv1)), length(dpdy(corner.uv1))),
    );
    let to_eye = normalize(camera.position_m.xyz - corner.place);
    let normal = turned_to_eye(normalize(corner.normal), to_eye);
    let point = MeshPoint(normal, corner.tangent, corner.uv, corner.uv1, corner.color, corner.material);
    // As in lens_surface.wgsl, so that both show the same surface.
    if coverage_at(point, spread, is_front) < 0.5 {
        discard;
    }
    let made = substance_over(point, spread);
    return Targets(
        vec4f(turned_to_eye(made.normal, to_eye), made.roughness),
        vec4f(normal, f32(corner.object) + 1.0),
        vec4f((1.0 - made.metallic) * made.transmission, made.ior, materials[corner.material].glass.z, 0.0),
    );
}
