//! Whether something has moved between two exposures, region by region.
//!
//! A single pixel cannot tell motion from bad luck, a region can: it has moved when too many of its pixels differ by more than
//! noise explains (Gallo et al. 2009, "Artifact-free high dynamic range imaging", which asks the same of patches,
//! with the noise of the response curve in log exposure).

use super::{Clipping, Sample};

/// When a region counts as moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionTest {
    /// Standard deviations of noise by which a pixel may differ.
    pub sigmas: f32,
    /// Share of the radiance by which a pixel may differ beyond noise: response, exposure times, alignment.
    pub tolerance: f32,
    /// Share of the comparable pixels of a region that may differ by more.
    pub fraction: f32,
    /// Number of pixels that may differ in any case: a few are no motion.
    pub spared_pixels: u32,
}

impl Default for MotionTest {
    /// 3 standard deviations and 5 %, for a tenth of the pixels or four of them.
    fn default() -> Self {
        Self {
            sigmas: 3.0,
            tolerance: 0.05,
            fraction: 0.1,
            spared_pixels: 4,
        }
    }
}

impl MotionTest {
    /// Whether two samples of one place differ; `None` when they cannot be compared, because both are clipped or both black.
    #[inline]
    #[must_use]
    pub fn differ(&self, a: &Sample, b: &Sample) -> Option<bool> {
        let difference = match (a.clipping, b.clipping) {
            (Clipping::Above, Clipping::Above) | (Clipping::Below, Clipping::Below) => return None,
            (Clipping::Above, Clipping::None | Clipping::Below) => (a.radiance - b.radiance).max(0.0),
            (Clipping::None | Clipping::Below, Clipping::Above) => (b.radiance - a.radiance).max(0.0),
            (Clipping::None | Clipping::Below, Clipping::None) | (Clipping::None, Clipping::Below) => {
                a.radiance - b.radiance
            }
        };
        // Were they the same, the better one would be nearer to the truth; its value sets what noise to expect.
        let (va, vb) = (a.variance_at(a.radiance), b.variance_at(b.radiance));
        let radiance = (a.radiance * vb + b.radiance * va) / (va + vb);
        let noise = a.variance_at(radiance) + b.variance_at(radiance);
        let allowed = self.sigmas * noise.sqrt() + self.tolerance * radiance;
        Some(difference.abs() > allowed)
    }
}

/// How well two exposures of a region agree: a count over its pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Pixels that could be compared in at least one channel.
    pub comparable: u32,
    /// Those of them that differ in at least one channel.
    pub different: u32,
}

impl Agreement {
    /// Counts one pixel.
    #[inline]
    pub fn add(&mut self, test: &MotionTest, a: &[Sample; 3], b: &[Sample; 3]) {
        let (mut comparable, mut different) = (false, false);
        for (a, b) in a.iter().zip(b) {
            if let Some(differ) = test.differ(a, b) {
                comparable = true;
                different |= differ;
            }
        }
        self.comparable += u32::from(comparable);
        self.different += u32::from(different);
    }

    /// Whether the region has moved; one without comparable pixels has not.
    #[must_use]
    pub fn has_moved(&self, test: &MotionTest) -> bool {
        self.different > test.spared_pixels && self.different as f32 > test.fraction * self.comparable as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(radiance: f32, clipping: Clipping) -> Sample {
        Sample {
            radiance,
            shot: 0.0,
            floor: 1e-4,
            clipping,
        }
    }

    #[test]
    fn bounds_differ_only_when_broken() {
        let test = MotionTest::default();
        let above = sample(5.0, Clipping::Above);
        assert_eq!(test.differ(&above, &sample(4.0, Clipping::None)), Some(true));
        assert_eq!(test.differ(&sample(4.0, Clipping::None), &above), Some(true));
        assert_eq!(test.differ(&above, &sample(9.0, Clipping::None)), Some(false));
        assert_eq!(test.differ(&above, &above), None);
        let black = sample(0.0, Clipping::Below);
        assert_eq!(test.differ(&black, &black), None);
        assert_eq!(test.differ(&black, &sample(0.02, Clipping::None)), Some(false));
        assert_eq!(test.differ(&black, &sample(0.2, Clipping::None)), Some(true));
        assert_eq!(test.differ(&black, &above), Some(true));
    }

    #[test]
    fn a_region_moves_when_enough_of_it_does() {
        let test = MotionTest::default();
        let region = |n_different: u32| {
            let mut agreement = Agreement::default();
            for i in 0..100 {
                let other = if i < n_different { 2.0 } else { 1.0 };
                // One channel is enough.
                let a = [1.0, 1.0, 1.0].map(|r| sample(r, Clipping::None));
                let b = [1.0, other, 1.0].map(|r| sample(r, Clipping::None));
                agreement.add(&test, &a, &b);
            }
            agreement
        };
        assert!(!region(10).has_moved(&test));
        assert!(region(11).has_moved(&test));
        let few = Agreement {
            comparable: 5,
            different: 4,
        };
        assert!(!few.has_moved(&test));
        assert!(!Agreement::default().has_moved(&test));
    }
}
