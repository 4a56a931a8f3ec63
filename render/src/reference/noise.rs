//! Noise of a pixel that is not the camera's own, from the covariance of what is mixed.

use glam::{DMat3, DVec3, UVec4, Vec3, Vec4};

use super::composite::{PixelOf, mixed_signal};

/// The code of the pixel that [`composite::pixel`](super::composite::pixel) gives, with the noise that it lacks; `frame` is
/// the number of the frame.
#[must_use]
pub fn pixel(of: &PixelOf<'_>, frame: u32, (code, ratio, over): ([u8; 3], Vec3, Vec4)) -> [u8; 3] {
    if over.w <= 0.0 && ratio == Vec3::ONE {
        return code;
    }
    let missing = missing_variance(of, code, ratio, over);
    let sigma = DVec3::from_array(missing.to_array().map(f64::sqrt));
    let at = of.pixel.as_uvec2();
    let noisy = mixed_signal(of, code, [ratio, Vec3::ZERO], over) + sigma * normals([at.x, at.y], frame);
    noisy.to_array().map(|y| of.camera.photometry.response.encode(y))
}

/// Variance that the signal of the mixed pixel lacks, red, green, blue: what the camera's model says for its light, less what
/// it has from the picture.
#[must_use]
pub fn missing_variance(of: &PixelOf<'_>, code: [u8; 3], ratio: Vec3, over: Vec4) -> DVec3 {
    let photometry = &of.camera.photometry;
    let channels = photometry.channel_noise(of.exposure);
    let model = |y: DVec3| {
        DVec3::from_array(std::array::from_fn(|c| {
            let per_electron = channels[c].signal_per_electron;
            per_electron * y[c].max(0.0) + (per_electron * channels[c].read_noise_e).powi(2)
        }))
    };
    let linear = DVec3::from_array(code.map(|c| photometry.response.linear_from_code(c)));
    // Clipped codes have no noise.
    let in_picture = model(linear) * DVec3::from_array(code.map(|c| if c == 255 { 0.0 } else { 1.0 }));
    // The mixed signal is a matrix times the picture's signal, plus what has no noise; its covariance follows.
    let signal = of.signal_per_radiance();
    let weight = DMat3::from_diagonal(ratio.as_dvec3() * (1.0 - f64::from(over.w)));
    let gain = DMat3::from_diagonal(signal)
        * photometry.color.inverse()
        * weight
        * photometry.color
        * DMat3::from_diagonal(signal.recip());
    let covariance = gain * DMat3::from_diagonal(in_picture) * gain.transpose();
    let carried = DVec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z);
    (model(mixed_signal(of, code, [ratio, Vec3::ZERO], over)) - carried).max(DVec3::ZERO)
}

/// Three independent normal numbers of a pixel (column, row) of a frame (Box and Muller 1958).
#[must_use]
pub fn normals(pixel: [u32; 2], frame: u32) -> DVec3 {
    let random = pcg4d(UVec4::new(pixel[0], pixel[1], frame, 0));
    let uniforms = random.to_array().map(|r| (f64::from(r >> 8) + 0.5) / 16_777_216.0);
    let radius = |u: f64| (-2.0 * u.ln()).sqrt();
    let [first, second] = [uniforms[2], uniforms[3]].map(|u| std::f64::consts::TAU * u);
    DVec3::new(
        radius(uniforms[0]) * first.cos(),
        radius(uniforms[0]) * first.sin(),
        radius(uniforms[1]) * second.cos(),
    )
}

/// Four integers that look random, from four (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering").
fn pcg4d(seed: UVec4) -> UVec4 {
    let [mut x, mut y, mut z, mut w] = seed
        .to_array()
        .map(|s| s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    for round in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        if round == 0 {
            [x, y, z, w] = [x, y, z, w].map(|v| v ^ (v >> 16));
        }
    }
    UVec4::new(x, y, z, w)
}
