// What the protection passes share (src/passes/protect.rs). World frame, metres.

// Pixels along the edge of a cell.
const CELL_PX: u32 = 4u;

// A square of pixels on one surface.
struct Cell {
    // Natural logarithm of the reflectance that picture and predicted light give; w: 1 where it means something.
    log_reflectance: vec4f,
    // Share of the bright lights in the predicted light; w: unused.
    share: vec4f,
    place_m: vec4f,
    normal: vec4f,
}

// What a cell's neighbours say of it.
struct Verdict {
    // xyz: logarithm of its reflectance if bright light is missing there; w: belief that it is, 0 to 1.
    shaded: vec4f,
}

// Surfaces are taken for one where they face the same way and lie in one plane to this height, metres: less than a sheet of
// cardboard, more than a mesh is uneven.
const SAME_PLANE_M: f32 = 0.001;

fn is_same_plane(place: vec3f, normal: vec3f, there: vec3f, normal_there: vec3f) -> bool {
    return dot(normal, normal_there) > 0.98 && abs(dot(there - place, normal)) < SAME_PLANE_M;
}
