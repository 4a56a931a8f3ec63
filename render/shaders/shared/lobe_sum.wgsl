// A cube filtered with a lobe: every texel sums the nodes of the light tree that its tile's list names.
// The importing shader gives `weights(cosines, variance)`, the lobe, for four texels at once.

struct Lobe {
    // x: alpha or exponent; y: edge of a face of the filtered cube, texels; z: factor of the result.
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

// Threads that share the nodes of a tile.
const SHARES: u32 = 16u;

// Sums of each thread: red, green and blue of 16 texels, four to a vector.
var<workgroup> partial: array<array<vec4f, 12>, 64>;

// Directions of the four texels of a row of a tile.
struct Row {
    x: vec4f,
    y: vec4f,
    z: vec4f,
}

fn row_of(size: u32, face: u32, first: vec2u) -> Row {
    let a = texel_direction(size, vec3u(first, face), vec2f(0.5));
    let b = texel_direction(size, vec3u(first + vec2u(1u, 0u), face), vec2f(0.5));
    let c = texel_direction(size, vec3u(first + vec2u(2u, 0u), face), vec2f(0.5));
    let d = texel_direction(size, vec3u(first + vec2u(3u, 0u), face), vec2f(0.5));
    return Row(vec4f(a.x, b.x, c.x, d.x), vec4f(a.y, b.y, c.y, d.y), vec4f(a.z, b.z, c.z, d.z));
}

// A tile is 4 × 4 texels. Each of its threads sums every sixteenth node for all of them, so that a node that is loaded
// serves 16 texels and short and long lists are done in little time.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let size = u32(lobe.parameters.y);
    let per_row = size / 4u;
    let tile = 4u * group.x + lane / SHARES;
    let share = lane % SHARES;
    let is_tile = tile < arrayLength(&tiles);
    let face = tile / (per_row * per_row);
    let corner = 4u * vec2u(tile % per_row, tile / per_row % per_row);
    var red: array<vec4f, 4>;
    var green: array<vec4f, 4>;
    var blue: array<vec4f, 4>;
    if is_tile {
        var rows = array<Row, 4>(
            row_of(size, face, corner),
            row_of(size, face, corner + vec2u(0u, 1u)),
            row_of(size, face, corner + vec2u(0u, 2u)),
            row_of(size, face, corner + vec2u(0u, 3u)),
        );
        let range = tiles[tile];
        for (var i = range.x + share; i < range.y; i += SHARES) {
            let node = nodes[entries[i]];
            for (var k = 0u; k < 4u; k++) {
                let cosines = rows[k].x * node.direction.x + rows[k].y * node.direction.y + rows[k].z * node.direction.z;
                let weight = weights(cosines, node.power.w);
                red[k] += weight * node.power.x;
                green[k] += weight * node.power.y;
                blue[k] += weight * node.power.z;
            }
        }
    }
    for (var k = 0u; k < 4u; k++) {
        partial[lane][k] = red[k];
        partial[lane][4u + k] = green[k];
        partial[lane][8u + k] = blue[k];
    }
    workgroupBarrier();
    if !is_tile {
        return;
    }
    // Now each thread takes one texel.
    let first = lane - share;
    let row = share / 4u;
    let column = share % 4u;
    var sum = vec3f(0.0);
    for (var i = first; i < first + SHARES; i++) {
        sum += vec3f(partial[i][row][column], partial[i][4u + row][column], partial[i][8u + row][column]);
    }
    let texel = corner + vec2u(column, row);
    let mean = sum * (lobe.parameters.z * scale[(face * size + texel.y) * size + texel.x]);
    textureStore(out, texel, face, vec4f(min(mean, vec3f(60000.0)), 1.0));
}
