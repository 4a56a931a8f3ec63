// A cube filtered with a lobe: every texel sums the nodes of the light tree that its tile's list names.
// The importing shader gives `weights(cosines, variance)`, the lobe, for four texels at once.

struct Lobe {
    // x: alpha or exponent; y: edge of a face of the filtered cube, texels; z: edge of a tile; w: factor of the result.
    parameters: vec4f,
}

@group(0) @binding(0) var<uniform> lobe: Lobe;
@group(0) @binding(1) var<storage, read> nodes: array<Node>;
// First and one past the last entry of each tile.
@group(0) @binding(2) var<storage, read> tiles: array<vec2u>;
@group(0) @binding(3) var<storage, read> entries: array<u32>;
// One over the sum of the weights in uniform light, per texel.
@group(0) @binding(4) var<storage, read> scale: array<f32>;
@group(0) @binding(5) var out: texture_storage_2d_array<rgba16float, write>;

// Mean of max(0, x) over x within √(3 variance) of the cosines: light spread across the horizon is partly above it.
fn above_horizon(cosines: vec4f, variance: f32) -> vec4f {
    let reach = max(sqrt(3.0 * variance), 1e-4);
    let within = clamp(cosines, vec4f(-reach), vec4f(reach)) + reach;
    return within * within * (0.25 / reach) + max(cosines - reach, vec4f(0.0));
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let size = u32(lobe.parameters.y);
    let edge = u32(lobe.parameters.z);
    // A thread takes 2 × 2 texels, so that each node is loaded once for four.
    let blocks = edge / 2u;
    let tile = id.x / (blocks * blocks);
    if tile >= arrayLength(&tiles) {
        return;
    }
    let block = id.x % (blocks * blocks);
    let per_row = size / edge;
    let face = tile / (per_row * per_row);
    let corner = edge * vec2u(tile % per_row, tile / per_row % per_row) + 2u * vec2u(block % blocks, block / blocks);
    let a = texel_direction(size, vec3u(corner, face), vec2f(0.5));
    let b = texel_direction(size, vec3u(corner + vec2u(1u, 0u), face), vec2f(0.5));
    let c = texel_direction(size, vec3u(corner + vec2u(0u, 1u), face), vec2f(0.5));
    let d = texel_direction(size, vec3u(corner + vec2u(1u, 1u), face), vec2f(0.5));
    let x = vec4f(a.x, b.x, c.x, d.x);
    let y = vec4f(a.y, b.y, c.y, d.y);
    let z = vec4f(a.z, b.z, c.z, d.z);
    var red = vec4f(0.0);
    var green = vec4f(0.0);
    var blue = vec4f(0.0);
    let range = tiles[tile];
    for (var i = range.x; i < range.y; i++) {
        let node = nodes[entries[i]];
        let cosines = x * node.direction.x + y * node.direction.y + z * node.direction.z;
        let weight = weights(cosines, node.power.w);
        red += weight * node.power.x;
        green += weight * node.power.y;
        blue += weight * node.power.z;
    }
    for (var i = 0u; i < 4u; i++) {
        let texel = corner + vec2u(i & 1u, i >> 1u);
        let factor = lobe.parameters.w * scale[(face * size + texel.y) * size + texel.x];
        let sum = factor * vec3f(red[i], green[i], blue[i]);
        textureStore(out, texel, face, vec4f(min(sum, vec3f(60000.0)), 1.0));
    }
}
