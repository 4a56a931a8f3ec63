//! The colour difference CIEDE2000, from linear ITU-R BT.709 colours.

/// L*, a*, b* of a linear colour, relative to the white of D65 (CIE 15; matrix of IEC 61966-2-1).
pub(crate) fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let row = |weights: [f64; 3], white: f64| {
        let sum: f64 = weights.iter().zip(rgb).map(|(weight, channel)| weight * channel).sum();
        let t = sum / white;
        if t > 216.0 / 24389.0 {
            t.cbrt()
        } else {
            (24389.0 / 27.0 * t + 16.0) / 116.0
        }
    };
    let x = row([0.412_391, 0.357_584, 0.180_481], 0.950_456);
    let y = row([0.212_639, 0.715_169, 0.072_192], 1.0);
    let z = row([0.019_331, 0.119_195, 0.950_532], 1.089_058);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// CIEDE2000 with all weights 1 (Sharma, Wu and Dalal 2005, equations 2 to 22).
pub(crate) fn delta_e_2000(one: [f64; 3], other: [f64; 3]) -> f64 {
    let chroma = |lab: [f64; 3]| lab[1].hypot(lab[2]);
    let mean_chroma7 = (0.5 * (chroma(one) + chroma(other))).powi(7);
    let g = 0.5 * (1.0 - (mean_chroma7 / (mean_chroma7 + 25_f64.powi(7))).sqrt());
    let polar = |lab: [f64; 3]| {
        let a = (1.0 + g) * lab[1];
        let hue = if a == 0.0 && lab[2] == 0.0 {
            0.0
        } else {
            lab[2].atan2(a).to_degrees().rem_euclid(360.0)
        };
        (a.hypot(lab[2]), hue)
    };
    let ((c1, h1), (c2, h2)) = (polar(one), polar(other));
    let has_hue = c1 * c2 != 0.0;
    let mut hue_step = h2 - h1;
    if hue_step > 180.0 {
        hue_step -= 360.0;
    } else if hue_step < -180.0 {
        hue_step += 360.0;
    }
    let hue_difference = if has_hue {
        2.0 * (c1 * c2).sqrt() * (0.5 * hue_step).to_radians().sin()
    } else {
        0.0
    };
    let mean_hue = match (has_hue, (h1 - h2).abs() <= 180.0, h1 + h2 < 360.0) {
        (false, _, _) => h1 + h2,
        (true, true, _) => 0.5 * (h1 + h2),
        (true, false, true) => 0.5 * (h1 + h2 + 360.0),
        (true, false, false) => 0.5 * (h1 + h2 - 360.0),
    };
    let cos = |degrees: f64| degrees.to_radians().cos();
    let t = 1.0 - 0.17 * cos(mean_hue - 30.0) + 0.24 * cos(2.0 * mean_hue) + 0.32 * cos(3.0 * mean_hue + 6.0)
        - 0.20 * cos(4.0 * mean_hue - 63.0);
    let (mean_l, mean_c) = (0.5 * (one[0] + other[0]), 0.5 * (c1 + c2));
    let l50 = (mean_l - 50.0).powi(2);
    let s_l = 1.0 + 0.015 * l50 / (20.0 + l50).sqrt();
    let (s_c, s_h) = (1.0 + 0.045 * mean_c, 1.0 + 0.015 * mean_c * t);
    let rotation = 30.0 * (-((mean_hue - 275.0) / 25.0).powi(2)).exp();
    let r_c = 2.0 * (mean_c.powi(7) / (mean_c.powi(7) + 25_f64.powi(7))).sqrt();
    let r_t = -(2.0 * rotation).to_radians().sin() * r_c;
    let (l, c, h) = ((other[0] - one[0]) / s_l, (c2 - c1) / s_c, hue_difference / s_h);
    (l * l + c * c + h * h + r_t * c * h).max(0.0).sqrt()
}

#[test]
fn published_pairs() {
    // Sharma, Wu and Dalal 2005, table 1: pairs 1, 4, 7, 9, 11, 13, 16, 17, 20, 24, 25, 28, 32, 34.
    for (one, other, expected) in [
        ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
        ([50.0, -1.3802, -84.2814], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0009], 7.1792),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0011], 7.2195),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0009, -2.4900], 4.8045),
        ([50.0, 2.5, 0.0], [50.0, 0.0, -2.5], 4.3065),
        ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
        ([50.0, 2.5, 0.0], [58.0, 24.0, 15.0], 19.4535),
        ([50.0, 2.5, 0.0], [50.0, 3.2592, 0.3350], 1.0000),
        ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
        ([22.7233, 20.0904, -46.6940], [23.0331, 14.9730, -42.5619], 2.0373),
        ([90.9257, -0.5406, -0.9208], [88.6381, -0.8985, -0.7239], 1.5381),
        ([2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082),
    ] {
        let found = delta_e_2000(one, other);
        assert!(
            (found - expected).abs() < 1e-4,
            "{one:?} {other:?}: {found}, {expected}"
        );
        assert!((delta_e_2000(other, one) - expected).abs() < 1e-4);
    }
}

#[test]
fn white_is_white() {
    let white = lab([1.0; 3]);
    assert!(
        (white[0] - 100.0).abs() < 1e-3 && white[1].abs() < 0.01 && white[2].abs() < 0.01,
        "{white:?}"
    );
}
