// Spherical harmonics to order 2, in the order Y00, Y1-1, Y10, Y11, Y2-2, Y2-1, Y20, Y21, Y22 (Ramamoorthi, Hanrahan 2001).

fn sh_basis(d: vec3f) -> array<f32, 9> {
    return array<f32, 9>(
        0.2820948,
        0.4886025 * d.y,
        0.4886025 * d.z,
        0.4886025 * d.x,
        1.0925484 * d.x * d.y,
        1.0925484 * d.y * d.z,
        0.31539157 * (3.0 * d.z * d.z - 1.0),
        1.0925484 * d.x * d.z,
        0.5462742 * (d.x * d.x - d.y * d.y),
    );
}

// Factors of the cosine lobe for each harmonic: pi, 2 pi / 3, pi / 4.
fn sh_cosine(i: u32) -> f32 {
    if i == 0u {
        return 3.1415927;
    }
    return select(0.7853982, 2.0943951, i < 4u);
}
