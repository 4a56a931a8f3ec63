// Sample points: Owen-scrambled (0, 2)-sequences, another one for every pixel and every decision along a path.

// PCG hash (Jarzynski and Olano 2020, "Hash functions for GPU rendering").
fn pcg(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Owen scrambling by a hash: every bit is flipped or not by all bits above it (Laine and Karras 2011; constants of Burley
// 2020, "Practical hash-based Owen scrambling").
fn scrambled(x: u32, seed: u32) -> u32 {
    var y = reverseBits(x) + seed;
    y ^= y * 0x6c50b47cu;
    y ^= y * 0xb82f1e52u;
    y ^= y * 0xc7afe638u;
    y ^= y * 0x8d22f6e6u;
    return reverseBits(y);
}

// Point `index` of the sequence for the decision `dimension` of the pixel that hashed to `seed`, in the unit square without
// its upper edges. The first 2, 4, 8, ... points fill it evenly.
fn sample_2d(index: u32, seed: u32, dimension: u32) -> vec2f {
    let own = pcg(seed ^ pcg(dimension));
    let shuffled = scrambled(index, own);
    let x = reverseBits(shuffled);
    // The second dimension of Sobol's sequence: its matrix is Pascal's triangle modulo 2, multiplied here by halves.
    var y = x;
    y ^= y << 16u;
    y ^= (y & 0x00ff00ffu) << 8u;
    y ^= (y & 0x0f0f0f0fu) << 4u;
    y ^= (y & 0x33333333u) << 2u;
    y ^= (y & 0x55555555u) << 1u;
    let point = vec2u(scrambled(x, pcg(own ^ 0x9e3779b9u)), scrambled(y, pcg(own ^ 0x85ebca6bu)));
    return vec2f(point >> vec2u(8u)) * 5.9604645e-8;
}

// Direction over the hemisphere around z with density cosine / pi.
fn cosine_direction(u: vec2f) -> vec3f {
    let radius = sqrt(u.x);
    let angle = 6.2831853 * u.y;
    return vec3f(radius * cos(angle), radius * sin(angle), sqrt(max(1.0 - u.x, 0.0)));
}

// Columns: two tangents and the normal itself (Duff et al. 2017, "Building an orthonormal basis, revisited").
fn basis_around(normal: vec3f) -> mat3x3f {
    let side = select(-1.0, 1.0, normal.z >= 0.0);
    let a = -1.0 / (side + normal.z);
    let b = normal.x * normal.y * a;
    return mat3x3f(
        vec3f(1.0 + side * normal.x * normal.x * a, side * b, -side * normal.x),
        vec3f(b, side + normal.y * normal.y * a, -normal.y),
        normal,
    );
}

// Weight of a sample drawn with density `own` that the other strategy draws with density `other` (Veach 1997, the power
// heuristic).
fn power_weight(own: f32, other: f32) -> f32 {
    return own * own / max(own * own + other * other, 1e-30);
}
