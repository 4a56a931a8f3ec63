use super::*;
use crate::response::ResponseCurve;

const SIZE: u32 = 16;

fn photometry() -> Photometry {
    Photometry {
        sensitivity: 40.0,
        vignetting: [0.0, 0.0],
        full_well_e: 12_000.0,
        read_noise_e: 6.0,
        response: ResponseCurve::srgb(),
        color: glam::DMat3::IDENTITY,
    }
}

fn noise(time_s: f64) -> (ViewNoise, f32) {
    let exposure = Exposure {
        time_s,
        gain: 1.0,
        white_balance: [1.0; 3],
    };
    let photometry = photometry();
    let signal = photometry.signal_per_radiance(&exposure)[0] as f32;
    (ViewNoise::new(&photometry, &exposure, Vec3::ONE), signal)
}

/// What a camera of this exposure shows of a room with these radiances, clipped at full scale.
fn picture(radiance: impl Fn(usize) -> f32, signal: f32, quality: f32) -> Vec<Vec4> {
    (0..FACES * (SIZE * SIZE) as usize)
        .map(|i| {
            let shown = (radiance(i) * signal).min(1.0) / signal;
            let clipped = if radiance(i) * signal >= 1.0 { 7 } else { 0 };
            Seen {
                radiance: Vec3::splat(shown),
                clipped,
                clipped_everywhere: clipped,
                quality,
            }
            .pack()
        })
        .collect()
}

/// A dim room with a lamp of a few texels.
fn room(lamp: f32) -> impl Fn(usize) -> f32 {
    move |i| if (100..108).contains(&i) { lamp } else { 0.2 }
}

#[test]
fn a_bracket_measures_lamp_and_room_and_a_switched_lamp_shows_in_the_next_picture() {
    let times = [0.02, 0.002, 0.0002].map(noise);
    let mut fusion = Fusion::new(SIZE, 0.08, 8);
    for k in 0..6 {
        let (noise, signal) = &times[k % 3];
        fusion.take(&[(&picture(room(90.0), *signal, 1.0), noise)]);
    }
    assert!(
        (fusion.radiance(103).x / 90.0 - 1.0).abs() < 0.01,
        "{}",
        fusion.radiance(103)
    );
    assert!((fusion.radiance(500).x / 0.2 - 1.0).abs() < 0.01);
    assert!(fusion.clipped().texels().iter().all(|bits| *bits == 0));
    let (long, signal) = &times[0];
    fusion.take(&[(&picture(room(0.2), *signal, 1.0), long)]);
    assert!(
        (fusion.radiance(103).x / 0.2 - 1.0).abs() < 0.01,
        "{}",
        fusion.radiance(103)
    );
    fusion.take(&[(&picture(room(90.0), *signal, 1.0), long)]);
    assert_eq!(fusion.clipped().texels()[103], 0b11_1111);
    let (short, signal) = &times[2];
    fusion.take(&[(&picture(room(90.0), *signal, 1.0), short)]);
    assert!(
        (fusion.radiance(103).x / 90.0 - 1.0).abs() < 0.01,
        "{}",
        fusion.radiance(103)
    );
}

#[test]
fn a_clipped_view_is_measured_by_one_that_does_not_clip() {
    let (sharp, signal) = noise(0.02);
    let (dim, dim_signal) = noise(0.002);
    let mut fusion = Fusion::new(SIZE, 0.08, 8);
    fusion.take(&[
        (&picture(room(5.0), signal, 0.9), &sharp),
        (&picture(room(5.0), dim_signal, 0.3), &dim),
    ]);
    assert!(
        (fusion.radiance(103).x / 5.0 - 1.0).abs() < 0.01,
        "{}",
        fusion.radiance(103)
    );
    assert_eq!(fusion.clipped().texels()[103], 0);
}

#[test]
fn a_dark_exposure_does_not_blacken_what_a_long_one_measured() {
    let (long, signal) = noise(0.02);
    let (short, short_signal) = noise(0.000_02);
    let mut fusion = Fusion::new(SIZE, 0.08, 8);
    for _ in 0..3 {
        fusion.take(&[(&picture(room(90.0), signal, 1.0), &long)]);
    }
    // Black is never below 0, so that its mean is too bright by 0.4 standard deviations of the read noise.
    let raised = |i: usize| room(90.0)(i) + 0.4 * 6.0 / 12_000.0 / short_signal;
    fusion.take(&[(&picture(raised, short_signal, 1.0), &short)]);
    let found = fusion.radiance(500).x;
    assert!((found / 0.2 - 1.0).abs() < 0.02, "{found}");
}

#[test]
fn a_lonely_contradiction_of_a_bad_view_must_come_twice() {
    let (noise, signal) = noise(0.02);
    let mut fusion = Fusion::new(SIZE, 0.08, 8);
    let with_speck = |i: usize| if i == 700 { 0.5 } else { 0.2 };
    fusion.take(&[(&picture(|_| 0.2, signal, 1.0), &noise)]);
    fusion.take(&[(&picture(with_speck, signal, 0.1), &noise)]);
    assert!((fusion.radiance(700).x - 0.2).abs() < 0.01);
    fusion.take(&[(&picture(with_speck, signal, 0.1), &noise)]);
    assert!((fusion.radiance(700).x - 0.5).abs() < 0.01);
}

#[test]
fn what_is_not_seen_ages_and_keeps_its_light() {
    let (noise, signal) = noise(0.02);
    let mut fusion = Fusion::new(SIZE, 0.08, 8);
    fusion.take(&[(&picture(|_| 0.2, signal, 1.0), &noise)]);
    let blind = vec![Vec4::ZERO; FACES * (SIZE * SIZE) as usize];
    for _ in 0..60 {
        fusion.take(&[(&blind, &noise)]);
    }
    assert_eq!(fusion.age(5), 60);
    assert!((fusion.confidence(5) - 0.5).abs() < 0.01);
    assert!((fusion.radiance(5).x - 0.2).abs() < 0.01);
}
