//! Probe picture to radiance cube: every direction asks the picture, exactly, for a light at finite distance.
//!
//! The cube's centre, the *origin*, is independent of the ball or lens that shows the light: direction d stands for the
//! point `origin + t(d) d`, with t the distance of the nearest phantom or of the room, and the picture is asked where it
//! shows that point. So a mirror ball beside a fisheye lens fills the same cube.
//!
//! The render node does the same on the GPU (its pass `radiance_map`); this is the plain version, for single pictures and
//! to compare with.
//!
//! # Quality
//!
//! `quality = min(1, n) · mean(r)` says how far a texel is to be trusted beside other views of the same direction.
//!
//! - n is the number of the picture's pixels per texel, which is the solid angle of the texel over that of a pixel: four
//!   times the area of the quadrilateral that the four sampled places make in the picture; 0 where one of them has no pixel.
//! - r is taken at each of the four places, 0 where it is not seen, else `S(x)` with `S(x) = x² (3 - 2x)` and x the least of
//!   three ramps that rise from 0 to 1: of the view's cosine c on the ball from c₀ = [`Trust::min_view_cosine`] to
//!   [`Trust::full_view_cosine`], since a pixel is stretched by 1/c²; of the distance to the ball's outline in the picture
//!   over [`OUTLINE_RAMP_PX`]; and of the distance to the end of a fisheye's round picture over [`RIM_RAMP_PX`].
//!
//! A place below the beginning of a ramp is not seen at all.

use glam::{DVec2, DVec3, Vec3, Vec4};

use super::cube::{Cube, FACES, face_direction};
use super::mapping::{Mapping, Place, ProbeMap};
use super::{ProbeOptics, Trust, View};

/// Distances to the ball's outline between which trust rises, pixels.
///
/// A bilinear sample of pixels that average over their area holds `(1.5 - x)³ / 6` of the background at x pixels inside a
/// straight edge (the integral of the quadratic B-spline): 7 % at the first distance, nothing from 1.5 pixels on.
pub const OUTLINE_RAMP_PX: [f64; 2] = [0.75, 2.0];

/// Distances to the end of a fisheye's round picture between which trust rises, pixels: beyond it is black.
pub const RIM_RAMP_PX: [f64; 2] = [2.0, 6.0];

/// Where a cube's light arrives, and what stands around it.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'a> {
    /// The cube's centre, world frame, metres.
    pub origin_m: Vec3,
    /// Distance from there to the first phantom in every direction, metres; more than `room_m` where there is none.
    pub near_m: &'a Cube<f32>,
    /// Distance of everything else, metres.
    pub room_m: f32,
}

/// What a picture says of one texel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Linear radiance in the rig's common RGB.
    pub radiance: Vec3,
    /// The camera's channels that clip anywhere in the texel: bit 0 red, 1 green, 2 blue.
    pub clipped: u8,
    /// Those that clip everywhere in it.
    pub clipped_everywhere: u8,
    /// Share of trust beside other views, 0 ..= 1.
    pub quality: f32,
}

impl Seen {
    /// The texel of a radiance cube: rgb radiance; a 1 plus the bits of `clipped`, 8 times those of `clipped_everywhere`,
    /// and 64 times `quality` in 255ths. All are whole numbers below 2²⁴, so that single precision holds them exactly.
    #[must_use]
    pub fn pack(&self) -> Vec4 {
        let bits = f32::from(self.clipped | (self.clipped_everywhere << 3));
        self.radiance.extend(1.0 + bits + 64.0 * (255.0 * self.quality).round())
    }

    /// What a texel says; `None` for one that was not seen.
    #[must_use]
    pub fn unpack(texel: Vec4) -> Option<Self> {
        if texel.w < 1.0 {
            return None;
        }
        let packed = texel.w as u32 - 1;
        Some(Self {
            radiance: texel.truncate(),
            clipped: (packed & 7) as u8,
            clipped_everywhere: (packed >> 3 & 7) as u8,
            quality: (packed >> 6) as f32 / 255.0,
        })
    }
}

/// The cube that `view` of the probe shows; texels as [`Seen::pack`] writes them, 0 where nothing is seen.
#[must_use]
pub fn cube(
    view: &View<'_>,
    optics: &ProbeOptics,
    mapping: Mapping,
    trust: &Trust,
    around: &Surroundings<'_>,
) -> Cube<Vec4> {
    let size = around.near_m.size();
    let asked = Asked {
        view,
        map: ProbeMap {
            intrinsics: &view.camera.intrinsics,
            camera_from_world: view.camera_from_world,
            optics,
        },
        mapping,
        trust,
    };
    let mut cube = Cube::filled(size, Vec4::ZERO);
    for face in 0..FACES {
        for y in 0..size {
            for x in 0..size {
                let index = (face * size as usize + y as usize) * size as usize + x as usize;
                let distance_m = f64::from(around.near_m.texels()[index].min(around.room_m));
                let places = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)].map(|(dx, dy)| {
                    let at = |t: u32, d: f32| (t as f32 + d) / size as f32 * 2.0 - 1.0;
                    let direction = face_direction(face, at(x, dx), at(y, dy)).as_dvec3().normalize();
                    asked.sample_place(direction, around.origin_m.as_dvec3() + direction * distance_m)
                });
                cube.texels_mut()[index] = asked.texel(places).map_or(Vec4::ZERO, |seen| seen.pack());
            }
        }
    }
    cube
}

impl Trust {
    /// Cosine from which on a reflection on the ball is fully trusted.
    #[must_use]
    pub fn full_view_cosine(&self) -> f32 {
        (3.0 * self.min_view_cosine).min(0.5 * (1.0 + self.min_view_cosine))
    }

    /// How far a place in the picture is trusted, 0 ..= 1; `None` where it is not seen.
    #[must_use]
    pub fn share(&self, place: &Place, own_image_rad: f64) -> Option<f64> {
        let cosines = [self.min_view_cosine, self.full_view_cosine()].map(f64::from);
        let least = [
            ramp(place.view_cosine, cosines),
            ramp(place.outline_px, OUTLINE_RAMP_PX),
            ramp(place.rim_px, RIM_RAMP_PX),
        ]
        .into_iter()
        .fold(1.0, f64::min);
        (least >= 0.0 && place.from_camera_rad >= own_image_rad).then_some(least * least * (3.0 - 2.0 * least))
    }
}

/// 0 at the first of two limits, 1 at and beyond the second, negative before.
fn ramp(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).min(1.0)
}

/// A picture with everything that decides what it says of a direction.
struct Asked<'a> {
    view: &'a View<'a>,
    map: ProbeMap<'a>,
    mapping: Mapping,
    trust: &'a Trust,
}

/// A pixel and how far it is trusted; `None` for not at all.
type SamplePlace = (DVec2, Option<f64>);

impl Asked<'_> {
    /// Pixel that shows the light at `light_m`, which lies towards `direction` from the origin.
    fn sample_place(&self, direction: DVec3, light_m: DVec3) -> Option<SamplePlace> {
        match self.mapping {
            Mapping::Exact => {
                let place = self.map.place(light_m)?;
                Some((place.pixel, self.trust.share(&place, self.own_image_rad())))
            }
            Mapping::Simple { wrap } => Some((self.map.simple_pixel(direction, wrap)?, Some(1.0))),
        }
    }

    /// Angle around the camera's own image in the ball that is left out.
    fn own_image_rad(&self) -> f64 {
        let camera_m = self.map.camera_from_world.inverse().translation;
        let distance_m = camera_m.distance(self.map.optics.position_m().as_dvec3());
        (f64::from(self.trust.camera_radius_m) / distance_m.max(1e-3))
            .min(1.0)
            .asin()
    }

    /// Mean over the places of a texel that the picture shows, if it shows at least half of them.
    fn texel(&self, places: [Option<SamplePlace>; 4]) -> Option<Seen> {
        let (mut sum, mut n_seen, mut clipped, mut everywhere, mut trust) = (Vec3::ZERO, 0, 0, 7, 0.0);
        for (pixel, share) in places.into_iter().flatten() {
            if let (Some(share), Some(sample)) = (share, self.view.picture.sample(pixel)) {
                sum += sample.radiance;
                n_seen += 1;
                clipped |= sample.clipped;
                everywhere &= self.clipped_everywhere(pixel);
                trust += 0.25 * share;
            }
        }
        let reflectance = match self.map.optics {
            ProbeOptics::MirrorBall { reflectance, .. } => *reflectance,
            ProbeOptics::Fisheye { .. } => Vec3::ONE,
        };
        (n_seen >= 2).then(|| Seen {
            radiance: sum / (n_seen as f32 * reflectance),
            clipped,
            clipped_everywhere: everywhere,
            quality: (pixels_per_texel(places).min(1.0) * trust) as f32,
        })
    }

    /// Channels that clip in every pixel that bilinear sampling at `pixel` reads.
    fn clipped_everywhere(&self, pixel: DVec2) -> u8 {
        let low = pixel.floor();
        let high = pixel.ceil();
        [low, DVec2::new(high.x, low.y), DVec2::new(low.x, high.y), high]
            .into_iter()
            .filter_map(|corner| self.view.picture.sample(corner))
            .fold(7, |bits, sample| bits & sample.clipped)
    }
}

/// Area of a texel in the picture, from the places at its quarters; 0 where one of them has none.
fn pixels_per_texel(places: [Option<SamplePlace>; 4]) -> f64 {
    match places {
        [Some((a, _)), Some((b, _)), Some((c, _)), Some((d, _))] => 2.0 * (d - a).perp_dot(c - b).abs(),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use mirrorball_capture::frame::{Exposure, Frame, FrameMeta, PixelFormat, Size};
    use proptest::prelude::*;

    use super::*;
    use crate::camera::{Intrinsics, LensModel};
    use crate::photometry::Photometry;
    use crate::pose::Pose;
    use crate::probe::mapping::LightSphere;
    use crate::probe::mirror_ball::MirrorBall;
    use crate::probe::radiance::Picture;
    use crate::response::ResponseCurve;
    use crate::rig::{Camera, Role};

    proptest! {
        #[test]
        fn texels_are_unpacked_as_packed(bits in 0u8..64, steps in 0u32..256, radiance in -1.0f32..1e6) {
            let seen = Seen {
                radiance: Vec3::new(radiance, 2.0, 3.0),
                clipped: bits & 7,
                clipped_everywhere: bits >> 3,
                quality: steps as f32 / 255.0,
            };
            prop_assert_eq!(Seen::unpack(seen.pack()), Some(seen));
        }
    }

    #[test]
    fn nothing_seen_is_nothing() {
        assert_eq!(Seen::unpack(Vec4::ZERO), None);
    }

    /// A ball 0.5 m before a camera; its picture is 100 pixels wide.
    fn camera() -> Camera {
        Camera {
            name: "scene".to_owned(),
            role: Role::Scene,
            intrinsics: Intrinsics {
                size_px: [320, 240],
                focal_px: DVec2::new(500.0, 500.0),
                principal_point_px: DVec2::new(160.2, 119.6),
                lens: LensModel::BrownConrady {
                    k1: -0.1,
                    k2: 0.03,
                    p1: 0.0,
                    p2: 0.0,
                    k3: 0.0,
                },
            },
            photometry: Photometry {
                sensitivity: 40.0,
                vignetting: [0.0; 2],
                full_well_e: 1e4,
                read_noise_e: 0.0,
                response: ResponseCurve::srgb(),
                color: DMat3::IDENTITY,
            },
            camera_from_world: None,
        }
    }

    #[test]
    fn quality_is_the_texel_over_the_pixel_where_nothing_else_counts() {
        let camera = camera();
        let exposure = Exposure {
            time_s: 0.01,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let frame = Frame {
            meta: FrameMeta::new("scene".into(), 0, 0, exposure),
            size: Size {
                width: 320,
                height: 240,
            },
            format: PixelFormat::Rgb8,
            pixels: vec![128; 3 * 320 * 240].into(),
        };
        let ball = MirrorBall {
            center_m: DVec3::new(0.02, 0.01, 0.5),
            radius_m: 0.05,
        };
        let optics = ProbeOptics::MirrorBall {
            ball,
            reflectance: Vec3::splat(0.5),
        };
        let view = View {
            picture: Picture::new(&frame, &camera),
            camera: &camera,
            camera_from_world: Pose::identity(),
        };
        let near_m = Cube::filled(64, 1e9);
        let around = Surroundings {
            origin_m: Vec3::new(-0.1, 0.0, 0.6),
            near_m: &near_m,
            room_m: 1.5,
        };
        let cube = cube(&view, &optics, Mapping::Exact, &Trust::default(), &around);
        let map = ProbeMap {
            intrinsics: &camera.intrinsics,
            camera_from_world: Pose::identity(),
            optics: &optics,
        };
        let sphere = LightSphere {
            origin_m: around.origin_m.as_dvec3(),
            distance_m: 1.5,
        };
        let mut compared = 0;
        for index in 0..cube.texels().len() {
            let light_m = sphere.origin_m + cube.direction(index).as_dvec3() * 1.5;
            let place = map.place(light_m);
            let Some(seen) = Seen::unpack(cube.texels()[index]) else {
                let is_hidden = place.is_none_or(|p| p.view_cosine < 0.2 || p.from_camera_rad < 0.13);
                assert!(is_hidden, "texel {index} is not seen: {place:?}");
                continue;
            };
            let place = place.expect("it was seen");
            if place.view_cosine < 0.4 || place.outline_px < 3.0 || place.from_camera_rad < 0.15 {
                continue;
            }
            let light = map.light(place.pixel, &sphere).expect("on the ball");
            let expected = f64::from(cube.solid_angle(index)) / light.solid_angle_per_pixel;
            assert!(expected < 1.0, "the ball is too sharp for this test");
            // A texel is finite, its middle is not: a per cent; and steps of 1/255.
            assert!(
                (f64::from(seen.quality) - expected).abs() < 0.02 * expected + 0.003,
                "{} {expected}",
                seen.quality
            );
            compared += 1;
        }
        assert!(compared > 15_000, "{compared} texels were compared");
    }

    #[test]
    fn trust_rises_from_the_rim_without_a_cliff() {
        let trust = Trust::default();
        let place = |view_cosine: f64, outline_px: f64, rim_px: f64| Place {
            pixel: DVec2::ZERO,
            view_cosine,
            outline_px,
            rim_px,
            from_camera_rad: 1.0,
        };
        let share = |c: f64, outline_px: f64, rim_px: f64| trust.share(&place(c, outline_px, rim_px), 0.1);
        assert_eq!(share(0.31, 2.0, 6.0), Some(1.0));
        for (first, step) in [((0.1, 9.0, 9.0), 0), ((1.0, 0.75, 9.0), 1), ((1.0, 9.0, 2.0), 2)] {
            let moved = |by: f64| {
                let mut p = [first.0, first.1, first.2];
                p[step] += by;
                share(p[0], p[1], p[2])
            };
            assert_eq!(moved(-1e-3), None);
            assert!(moved(1e-3).is_some_and(|share| share < 1e-3));
            let shares: Vec<f64> = (1..100).filter_map(|i| moved(f64::from(i) * 0.01)).collect();
            assert!(shares.is_sorted() && shares.len() == 99);
        }
        assert_eq!(
            trust.share(&place(1.0, 50.0, f64::INFINITY), 1.1),
            None,
            "the camera's own image"
        );
    }
}
