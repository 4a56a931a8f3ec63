// What a pinhole view sees: place, normal and base colour of the first surface of every pixel.

#import lights
#import view

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> objects: array<Object>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) place: vec3f,
    @location(1) normal: vec3f,
    @location(2) @interpolate(flat) object: u32,
    @location(3) @interpolate(flat) material: u32,
}

struct Targets {
    @location(0) place: vec4f,
    @location(1) normal: vec4f,
    @location(2) color: vec4f,
}

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @location(2) normal: vec3f,
    @location(3) material: u32,
) -> Corner {
    let world_from_object = objects[object].world_from_object;
    let place = world_from_object * vec4f(position, 1.0);
    return Corner(view.clip_from_world * place, place.xyz, (world_from_object * vec4f(normal, 0.0)).xyz, object, material);
}

@fragment
fn fragment(corner: Corner) -> Targets {
    let to_eye = view.eye_m.xyz - corner.place;
    let across = cross(dpdx(corner.place), dpdy(corner.place));
    var normal = normalize(corner.normal);
    if dot(normal, across) * dot(to_eye, across) < 0.0 {
        // Seen from behind (an open mesh).
        normal = -normal;
    }
    if dot(normal, to_eye) < 0.0 {
        // An interpolated normal turned away at the outline.
        normal = normalize(normal - 1.01 * dot(normal, to_eye) / dot(to_eye, to_eye) * to_eye);
    }
    return Targets(
        vec4f(corner.place, 1.0),
        vec4f(normal, f32(corner.object)),
        vec4f(materials[corner.material].base_color.rgb, 1.0),
    );
}
