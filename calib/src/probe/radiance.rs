//! From pixel codes to scene radiance: the camera's own model turned around.

use glam::{DVec2, Mat3, Vec3};
use mirrorball_capture::frame::Frame;

use crate::rig::Camera;

/// The code at which a channel counts as clipped: the brightest code stands for everything above it.
pub const CLIPPED_CODE: u8 = 255;

/// A frame together with what its camera's codes mean.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    frame: &'a Frame,
    camera: &'a Camera,
    signal_per_radiance: Vec3,
    common_from_camera: Mat3,
}

/// Radiance at a place in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Linear radiance in the rig's common RGB.
    pub radiance: Vec3,
    /// Which of the camera's channels are clipped, bit 0 red, bit 1 green, bit 2 blue.
    pub clipped: u8,
}

impl<'a> Picture<'a> {
    /// A frame of `camera`; its size must be the one in the rig.
    #[must_use]
    pub fn new(frame: &'a Frame, camera: &'a Camera) -> Self {
        let signal = camera.photometry.signal_per_radiance(&frame.meta.exposure);
        Self {
            frame,
            camera,
            signal_per_radiance: Vec3::from_array(signal.map(|s| s as f32)),
            common_from_camera: camera.photometry.color.as_mat3(),
        }
    }

    /// Signal of the camera's channels per unit of radiance in the middle of the picture; 1 is full scale.
    #[must_use]
    pub fn signal_per_radiance(&self) -> Vec3 {
        self.signal_per_radiance
    }

    /// Radiance at `pixel` (centres at integers), bilinear in linear light; `None` outside the outermost pixel centres.
    #[must_use]
    pub fn sample(&self, pixel: DVec2) -> Option<Sample> {
        let [width, height] = [self.frame.size.width as usize, self.frame.size.height as usize];
        let (x, y) = (pixel.x, pixel.y);
        if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f64 && y <= (height - 1) as f64) {
            return None;
        }
        let (x0, y0) = (
            (x as usize).min(width.saturating_sub(2)),
            (y as usize).min(height.saturating_sub(2)),
        );
        let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
        let mut signal = Vec3::ZERO;
        let mut clipped = 0;
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let weight = (if dx == 0 { 1.0 - fx } else { fx }) * (if dy == 0 { 1.0 - fy } else { fy });
            let (px, py) = ((x0 + dx).min(width - 1), (y0 + dy).min(height - 1));
            if weight > 0.0 {
                let at = 3 * (py * width + px);
                let code = &self.frame.pixels[at..at + 3];
                let linear = self.camera.photometry.response.table();
                signal += weight
                    * Vec3::new(
                        linear[code[0] as usize],
                        linear[code[1] as usize],
                        linear[code[2] as usize],
                    );
                for (bit, &c) in code.iter().enumerate() {
                    clipped |= u8::from(c == CLIPPED_CODE) << bit;
                }
            }
        }
        let vignetting = self
            .camera
            .photometry
            .vignetting_at(pixel, self.camera.intrinsics.size_px) as f32;
        let radiance = self.common_from_camera * (signal / (self.signal_per_radiance * vignetting));
        Some(Sample { radiance, clipped })
    }
}

/// Rec. 709 luminance of linear RGB.
#[must_use]
pub fn luminance(radiance: Vec3) -> f32 {
    radiance.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}
