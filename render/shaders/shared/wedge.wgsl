// Casters of soft shadow volumes (src/shadow/wedge_outlines.rs).
struct WedgeShape {
    light_from_object: mat4x4f,
    // Box around it in the light's frame; low.w: 1 where its faces block from both sides.
    low: vec4f,
    high: vec4f,
    // First edge, number of edges, first face, number of faces.
    ranges: vec4u,
}
