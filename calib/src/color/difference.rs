//! How different two colours look: CIEDE2000.

/// XYZ of white under D65 (2° observer), Y = 1; what linear Rec. 709 values of 1 make.
pub const WHITE_D65: [f64; 3] = [0.950_47, 1.0, 1.088_83];

/// XYZ of white under D50, the white of colour charts' tables.
const WHITE_D50: [f64; 3] = [0.964_22, 1.0, 0.825_21];

/// XYZ from linear Rec. 709 / sRGB (IEC 61966-2-1).
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [0.412_456_4, 0.357_576_1, 0.180_437_5],
    [0.212_672_9, 0.715_152_2, 0.072_175_0],
    [0.019_333_9, 0.119_192_0, 0.950_304_1],
];

/// The inverse.
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.240_454_2, -1.537_138_5, -0.498_531_4],
    [-0.969_266_0, 1.876_010_8, 0.041_556_0],
    [0.055_643_4, -0.204_025_9, 1.057_225_2],
];

/// XYZ under D65 from XYZ under D50 (Bradford; Lam 1985, as tabulated by Lindbloom).
const D65_FROM_D50: [[f64; 3]; 3] = [
    [0.955_576_6, -0.023_039_3, 0.063_163_6],
    [-0.028_289_5, 1.009_941_6, 0.021_007_7],
    [0.012_298_2, -0.020_483_0, 1.329_909_8],
];

fn times(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// XYZ of linear Rec. 709 red, green, blue; Y = 1 for (1, 1, 1).
#[must_use]
pub fn xyz_from_linear_rgb(rgb: [f64; 3]) -> [f64; 3] {
    times(&XYZ_FROM_RGB, rgb)
}

/// Linear Rec. 709 red, green, blue of XYZ under D65; below 0 or above 1 out of gamut.
#[must_use]
pub fn linear_rgb_from_xyz(xyz: [f64; 3]) -> [f64; 3] {
    times(&RGB_FROM_XYZ, xyz)
}

/// Linear Rec. 709 red, green, blue of a colour tabulated as L*a*b* under D50.
#[must_use]
pub fn linear_rgb_from_lab_d50([l, a, b]: [f64; 3]) -> [f64; 3] {
    let fy = (l + 16.0) / 116.0;
    let f = [fy + a / 500.0, fy, fy - b / 200.0];
    let limit = 6.0 / 29.0;
    let xyz: [f64; 3] = std::array::from_fn(|i| {
        let ratio = if f[i] > limit {
            f[i].powi(3)
        } else {
            3.0 * limit * limit * (f[i] - 4.0 / 29.0)
        };
        WHITE_D50[i] * ratio
    });
    linear_rgb_from_xyz(times(&D65_FROM_D50, xyz))
}

/// L*a*b* of XYZ, seen beside `white` (CIE 15:2004, eq. 8.3 to 8.8).
#[must_use]
pub fn lab_from_xyz(xyz: [f64; 3], white: [f64; 3]) -> [f64; 3] {
    let limit = 6.0f64 / 29.0;
    let f: [f64; 3] = std::array::from_fn(|i| {
        let ratio = xyz[i] / white[i];
        if ratio > limit.powi(3) {
            ratio.cbrt()
        } else {
            ratio / (3.0 * limit * limit) + 4.0 / 29.0
        }
    });
    [116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])]
}

/// The CIEDE2000 difference of two L*a*b* colours, with kL = kC = kH = 1 (Sharma, Wu and Dalal 2005, "The CIEDE2000
/// color-difference formula: implementation notes", eq. 2 to 22). 1 is about what is just seen.
#[must_use]
pub fn ciede2000(first: [f64; 3], second: [f64; 3]) -> f64 {
    let seventh = |chroma: f64| (chroma.powi(7) / (chroma.powi(7) + 25f64.powi(7))).sqrt();
    let mean_chroma = 0.5 * (first[1].hypot(first[2]) + second[1].hypot(second[2]));
    let g = 0.5 * (1.0 - seventh(mean_chroma));
    let polar = |lab: [f64; 3]| {
        let a = (1.0 + g) * lab[1];
        let hue = if a == 0.0 && lab[2] == 0.0 {
            0.0
        } else {
            lab[2].atan2(a).to_degrees().rem_euclid(360.0)
        };
        (a.hypot(lab[2]), hue)
    };
    let ((c1, h1), (c2, h2)) = (polar(first), polar(second));
    let has_hues = c1 * c2 != 0.0;
    let turn = if has_hues {
        (h2 - h1 + 180.0).rem_euclid(360.0) - 180.0
    } else {
        0.0
    };
    let mean_hue = match (h1 - h2).abs() {
        _ if !has_hues => h1 + h2,
        // The formula's own rule for hues on either side of 0.
        apart if apart <= 180.0 => 0.5 * (h1 + h2),
        _ if h1 + h2 < 360.0 => 0.5 * (h1 + h2 + 360.0),
        _ => 0.5 * (h1 + h2 - 360.0),
    };
    let (dl, dc) = (second[0] - first[0], c2 - c1);
    let dh = 2.0 * (c1 * c2).sqrt() * (0.5 * turn).to_radians().sin();
    let (l, c) = (0.5 * (first[0] + second[0]), 0.5 * (c1 + c2));
    let cosine = |factor: f64, offset: f64| (factor * mean_hue + offset).to_radians().cos();
    let t =
        1.0 - 0.17 * cosine(1.0, -30.0) + 0.24 * cosine(2.0, 0.0) + 0.32 * cosine(3.0, 6.0) - 0.20 * cosine(4.0, -63.0);
    let turned = 30.0 * (-((mean_hue - 275.0) / 25.0).powi(2)).exp();
    let from_middle = (l - 50.0).powi(2);
    let sl = 1.0 + 0.015 * from_middle / (20.0 + from_middle).sqrt();
    let (sc, sh) = (1.0 + 0.045 * c, 1.0 + 0.015 * c * t);
    let rotation = -(2.0 * turned).to_radians().sin() * 2.0 * seventh(c);
    let (x, y, z) = (dl / sl, dc / sc, dh / sh);
    (x * x + y * y + z * z + rotation * y * z).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Sharma, Wu and Dalal 2005, table 1.
    const SHARMA: [[f64; 7]; 34] = [
        [50.0, 2.6772, -79.7751, 50.0, 0.0, -82.7485, 2.0425],
        [50.0, 3.1571, -77.2803, 50.0, 0.0, -82.7485, 2.8615],
        [50.0, 2.8361, -74.0200, 50.0, 0.0, -82.7485, 3.4412],
        [50.0, -1.3802, -84.2814, 50.0, 0.0, -82.7485, 1.0],
        [50.0, -1.1848, -84.8006, 50.0, 0.0, -82.7485, 1.0],
        [50.0, -0.9009, -85.5211, 50.0, 0.0, -82.7485, 1.0],
        [50.0, 0.0, 0.0, 50.0, -1.0, 2.0, 2.3669],
        [50.0, -1.0, 2.0, 50.0, 0.0, 0.0, 2.3669],
        [50.0, 2.49, -0.001, 50.0, -2.49, 0.0009, 7.1792],
        [50.0, 2.49, -0.001, 50.0, -2.49, 0.0010, 7.1792],
        [50.0, 2.49, -0.001, 50.0, -2.49, 0.0011, 7.2195],
        [50.0, 2.49, -0.001, 50.0, -2.49, 0.0012, 7.2195],
        [50.0, -0.001, 2.49, 50.0, 0.0009, -2.49, 4.8045],
        [50.0, -0.001, 2.49, 50.0, 0.0010, -2.49, 4.8045],
        [50.0, -0.001, 2.49, 50.0, 0.0011, -2.49, 4.7461],
        [50.0, 2.5, 0.0, 50.0, 0.0, -2.5, 4.3065],
        [50.0, 2.5, 0.0, 73.0, 25.0, -18.0, 27.1492],
        [50.0, 2.5, 0.0, 61.0, -5.0, 29.0, 22.8977],
        [50.0, 2.5, 0.0, 56.0, -27.0, -3.0, 31.9030],
        [50.0, 2.5, 0.0, 58.0, 24.0, 15.0, 19.4535],
        [50.0, 2.5, 0.0, 50.0, 3.1736, 0.5854, 1.0],
        [50.0, 2.5, 0.0, 50.0, 3.2972, 0.0, 1.0],
        [50.0, 2.5, 0.0, 50.0, 1.8634, 0.5757, 1.0],
        [50.0, 2.5, 0.0, 50.0, 3.2592, 0.3350, 1.0],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
        [61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731],
        [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146],
        [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
        [90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381],
        [6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ];

    #[test]
    fn the_published_pairs_come_out() {
        for (index, [l1, a1, b1, l2, a2, b2, expected]) in SHARMA.into_iter().enumerate() {
            let found = ciede2000([l1, a1, b1], [l2, a2, b2]);
            assert!(
                (found - expected).abs() < 1e-4,
                "pair {}: {found} {expected}",
                index + 1
            );
        }
    }

    #[test]
    fn white_is_white_in_every_unit() {
        let lab = lab_from_xyz(xyz_from_linear_rgb([1.0; 3]), WHITE_D65);
        assert!(
            (lab[0] - 100.0).abs() < 1e-3 && lab[1].abs() < 1e-2 && lab[2].abs() < 1e-2,
            "{lab:?}"
        );
        let rgb = linear_rgb_from_lab_d50([100.0, 0.0, 0.0]);
        assert!(rgb.iter().all(|value| (value - 1.0).abs() < 1e-3), "{rgb:?}");
        let grey = linear_rgb_from_lab_d50([50.0, 0.0, 0.0]);
        assert!((grey[1] - 0.184_187).abs() < 1e-3, "{grey:?}");
    }

    fn lab() -> impl Strategy<Value = [f64; 3]> {
        (0.0f64..100.0, -80.0f64..80.0, -80.0f64..80.0).prop_map(|(l, a, b)| [l, a, b])
    }

    proptest! {
        #[test]
        fn it_is_a_difference(a in lab(), b in lab()) {
            prop_assert!(ciede2000(a, a) < 1e-9);
            prop_assert!((ciede2000(a, b) - ciede2000(b, a)).abs() < 1e-9);
        }

        #[test]
        fn rgb_round_trip(r in 0.0f64..1.0, g in 0.0f64..1.0, b in 0.0f64..1.0) {
            let back = linear_rgb_from_xyz(xyz_from_linear_rgb([r, g, b]));
            prop_assert!(back.iter().zip([r, g, b]).all(|(x, y)| (x - y).abs() < 1e-5));
        }
    }
}
