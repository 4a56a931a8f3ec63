// What the scene camera sees through its own lens: place and normal of the first surface of every pixel.

#import camera
#import lights
#import material

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

struct Corner {
    @invariant @builtin(position) clip: vec4f,
    @location(0) place: vec3f,
    @location(1) normal: vec3f,
    @location(2) @interpolate(flat) object: u32,
    @location(3) @interpolate(flat) material: u32,
    // Both sets of texture coordinates.
    @location(4) uvs: vec4f,
    @location(5) color: vec4f,
    @location(6) tangent: vec4f,
}

struct Targets {
    @location(0) place: vec4f,
    @location(1) normal: vec4f,
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
    let along = vec4f((world_from_object * vec4f(tangent.xyz, 0.0)).xyz, tangent.w);
    return Corner(clip_of(camera, place), place, direction, object, material, vec4f(uv, uv1), color, along);
}

@fragment
fn fragment(corner: Corner, @builtin(front_facing) is_front: bool) -> Targets {
    let spread = vec2f(
        max(length(dpdx(corner.uvs.xy)), length(dpdy(corner.uvs.xy))),
        max(length(dpdx(corner.uvs.zw)), length(dpdy(corner.uvs.zw))),
    );
    let to_eye = normalize(camera.position_m.xyz - corner.place);
    var normal = turned_to_eye(normalize(corner.normal), to_eye);
    // Phantoms are whole whatever their files say of sides and alpha, and as smooth as their meshes.
    if objects[corner.object].environment.y == 1u {
        let point = MeshPoint(normal, corner.tangent, corner.uvs.xy, corner.uvs.zw, corner.color, corner.material);
        if coverage_at(point, spread, is_front) < 0.5 {
            discard;
        }
        normal = turned_to_eye(mapped_normal(point, spread), to_eye);
    }
    return Targets(vec4f(corner.place, 1.0), vec4f(normal, f32(corner.object)));
}
