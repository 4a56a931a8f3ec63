// Nodes of the light tree over a radiance cube (src/light_tree.rs): light of a patch of the sphere as one little light.

struct Node {
    // xyz: radiance times solid angle; w: variance of the light around its centre along one axis, rad².
    power: vec4f,
    // xyz: unit direction of the centre; w: solid angle of the patch, steradians.
    direction: vec4f,
}
