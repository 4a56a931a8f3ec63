//! The code of no light, from pictures with the lens covered.

/// Share of the pixels, at either end, that do not count: hot pixels, light leaks.
const TRIMMED: f64 = 0.01;

/// Largest median code of a dark picture.
const MAX_DARK_CODE: u8 = 64;

/// Distance in codes from the median at which a pixel is hot.
const HOT_CODES: u8 = 24;

/// What a camera shows without light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlackLevel {
    /// Mean code of red, green and blue.
    pub channels: [f64; 3],
    /// Mean code of all three.
    pub code: f64,
    /// Standard deviation of single pixels, in codes.
    pub deviation: f64,
    /// Share of the values that are far above the rest.
    pub hot_share: f64,
}

/// Why there is no black level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BlackError {
    /// There is no pixel.
    #[error("there is no dark picture (allowed: 1 or more)")]
    None,
    /// A picture is not dark.
    #[error("dark picture `{picture}` is not dark: its median code is `{found}` (allowed: at most `64`)")]
    NotDark {
        /// Index of the picture.
        picture: usize,
        /// Its median code.
        found: u8,
    },
}

/// Measures the black level from dark pictures (red, green, blue of each pixel).
///
/// # Errors
/// When there is none, or one is not dark.
pub fn measure(pictures: &[&[u8]]) -> Result<BlackLevel, BlackError> {
    let mut counts = [[0u64; 256]; 3];
    for (picture, codes) in pictures.iter().enumerate() {
        let mut own = [[0u64; 256]; 3];
        for pixel in codes.chunks_exact(3) {
            for (counts, &code) in own.iter_mut().zip(pixel) {
                counts[usize::from(code)] += 1;
            }
        }
        let found = own.iter().map(median).max().unwrap_or(0);
        if found > MAX_DARK_CODE {
            return Err(BlackError::NotDark { picture, found });
        }
        for (all, own) in counts.iter_mut().flatten().zip(own.iter().flatten()) {
            *all += own;
        }
    }
    if counts[0].iter().sum::<u64>() == 0 {
        return Err(BlackError::None);
    }
    let moments = counts.each_ref().map(trimmed_moments);
    let hot = |counts: &[u64; 256]| -> u64 {
        let first = usize::from(median(counts).saturating_add(HOT_CODES));
        counts[first..].iter().sum()
    };
    let n: u64 = counts.iter().flatten().sum();
    Ok(BlackLevel {
        channels: moments.map(|(mean, _)| mean),
        code: moments.iter().map(|(mean, _)| mean).sum::<f64>() / 3.0,
        deviation: (moments.iter().map(|(_, variance)| variance).sum::<f64>() / 3.0).sqrt(),
        hot_share: counts.iter().map(hot).sum::<u64>() as f64 / n as f64,
    })
}

fn median(counts: &[u64; 256]) -> u8 {
    let half = counts.iter().sum::<u64>() / 2;
    let mut sum = 0;
    let at = counts.iter().position(|&count| {
        sum += count;
        sum > half
    });
    at.unwrap_or(0) as u8
}

/// Mean and variance without the ends; pixels that share a code are cut in parts, not all or none.
fn trimmed_moments(counts: &[u64; 256]) -> (f64, f64) {
    let n = counts.iter().sum::<u64>() as f64;
    let (low, high) = (TRIMMED * n, (1.0 - TRIMMED) * n);
    let (mut before, mut weight, mut sum, mut squares) = (0.0, 0.0, 0.0, 0.0);
    for (code, &count) in counts.iter().enumerate() {
        let after = before + count as f64;
        let kept = (after.min(high) - f64::max(before, low)).max(0.0);
        let code = code as f64;
        weight += kept;
        sum += kept * code;
        squares += kept * code * code;
        before = after;
    }
    let mean = sum / weight;
    (mean, (squares / weight - mean * mean).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::simulate::Random;

    #[test]
    fn black_comes_back_in_spite_of_hot_pixels() {
        let mut random = Random::new(3);
        let levels = [15.6, 16.0, 17.2];
        let mut picture: Vec<u8> = (0..60_000)
            .map(|i| (levels[i % 3] + 1.2 * random.normal()).round() as u8)
            .collect();
        for i in 0..300 {
            picture[i * 199] = 255;
        }
        let black = measure(&[&picture, &picture]).unwrap();
        for (found, level) in black.channels.into_iter().zip(levels) {
            // Half a per cent of hot pixels moves a trimmed mean by a fiftieth of a standard deviation.
            assert!((found - level).abs() < 0.05, "{black:?}");
        }
        assert!((black.deviation / 1.2 - 1.0).abs() < 0.1, "{black:?}");
        assert!((black.hot_share - 0.005).abs() < 1e-3, "{black:?}");
    }

    #[test]
    fn light_is_refused() {
        assert_eq!(measure(&[]), Err(BlackError::None));
        let error = measure(&[&[3; 30], &[90; 30]]).unwrap_err();
        assert_eq!(error, BlackError::NotDark { picture: 1, found: 90 });
    }
}
