// Corners and faces of the casters in the light's own frame (src/shadow/wedges.rs), once per frame for all pixels.

#import wedge

@group(0) @binding(0) var<storage, read> shapes: array<WedgeShape>;
// xyz: place in the object's frame; w: index of the shape.
@group(0) @binding(1) var<storage, read> corners: array<vec4f>;
@group(0) @binding(2) var<storage, read> faces: array<vec4u>;
@group(0) @binding(3) var<storage, read_write> placed: array<vec4f>;
// xyz: normal, of any length; w: minus its product with a place on the face.
@group(0) @binding(4) var<storage, read_write> planes: array<vec4f>;

fn in_light(corner: u32) -> vec3f {
    let at = corners[corner];
    return (shapes[u32(at.w)].light_from_object * vec4f(at.xyz, 1.0)).xyz;
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let i = at.x;
    if i < arrayLength(&placed) {
        placed[i] = vec4f(in_light(i), 1.0);
    }
    if i < arrayLength(&planes) {
        let face = faces[i];
        let a = in_light(face.x);
        let normal = cross(in_light(face.y) - a, in_light(face.z) - a);
        planes[i] = vec4f(normal, -dot(normal, a));
    }
}
