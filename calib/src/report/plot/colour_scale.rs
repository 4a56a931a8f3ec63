//! Values as colours.

/// Viridis at eleven places (Smith and van der Walt 2015, in Matplotlib, CC0; values of R's `viridis(11)`): its lightness
/// grows evenly, so that order is seen as order, in grey and by colour-blind eyes too.
const VIRIDIS: [[u8; 3]; 11] = [
    [0x44, 0x01, 0x54],
    [0x48, 0x25, 0x76],
    [0x41, 0x44, 0x87],
    [0x35, 0x5f, 0x8d],
    [0x2a, 0x78, 0x8e],
    [0x21, 0x90, 0x8c],
    [0x22, 0xa8, 0x84],
    [0x43, 0xbf, 0x71],
    [0x7a, 0xd1, 0x51],
    [0xbb, 0xdf, 0x27],
    [0xfd, 0xe7, 0x25],
];

/// The colour for a value of 0 (dark) to 1 (bright), as `#rrggbb`; linear in the encoded colours between the listed ones.
pub(super) fn viridis(value: f64) -> String {
    let place = value.clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f64;
    let below = (place.floor() as usize).min(VIRIDIS.len() - 2);
    let part = place - below as f64;
    let mix = |channel: usize| {
        let (low, high) = (
            f64::from(VIRIDIS[below][channel]),
            f64::from(VIRIDIS[below + 1][channel]),
        );
        (low + part * (high - low)).round() as u8
    };
    let [r, g, b] = [0, 1, 2].map(mix);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// An encoded sRGB colour of 0 to 1, clipped, as `#rrggbb`; `None` where a channel is no number.
pub(super) fn encoded(colour: [f64; 3]) -> Option<String> {
    if colour.iter().any(|channel| channel.is_nan()) {
        return None;
    }
    let [r, g, b] = colour.map(|channel| (channel.clamp(0.0, 1.0) * 255.0).round() as u8);
    Some(format!("#{r:02x}{g:02x}{b:02x}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_grows_lighter_evenly() {
        // CIE L* of the encoded colour, from relative luminance.
        let lightness = |value: f64| {
            let hex = viridis(value);
            let linear = |at: usize| {
                let encoded = f64::from(u8::from_str_radix(&hex[at..at + 2], 16).unwrap()) / 255.0;
                if encoded <= 0.04045 {
                    encoded / 12.92
                } else {
                    ((encoded + 0.055) / 1.055).powf(2.4)
                }
            };
            let luminance = 0.2126 * linear(1) + 0.7152 * linear(3) + 0.0722 * linear(5);
            116.0 * luminance.cbrt() - 16.0
        };
        let steps: Vec<f64> = (0..20)
            .map(|i| lightness(f64::from(i + 1) / 20.0) - lightness(f64::from(i) / 20.0))
            .collect();
        let mean = steps.iter().sum::<f64>() / 20.0;
        assert!(steps.iter().all(|step| (step / mean - 1.0).abs() < 0.35), "{steps:?}");
    }

    #[test]
    fn ends_and_beyond() {
        assert_eq!(viridis(0.0), "#440154");
        assert_eq!(viridis(1.0), "#fde725");
        assert_eq!(viridis(-3.0), viridis(0.0));
        assert_eq!(viridis(f64::INFINITY), viridis(1.0));
        assert_eq!(encoded([0.0, 0.5, 2.0]), Some("#0080ff".to_owned()));
        assert_eq!(encoded([0.0, f64::NAN, 0.0]), None);
    }
}
