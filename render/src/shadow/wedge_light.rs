//! The rectangle that soft shadow volumes take a light for, and its frame.

use glam::{Affine3A, Mat3A, Vec3, Vec3A};

use super::light::ShadowLight;
use crate::error::RenderError;
use crate::shadow::shadow_view::{Sphere, basis};

/// How the covered share of the light is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coverage {
    /// Layers of shadow are counted before each of 512 samples: right however many outlines overlap (Laine, Aila, Assarsson,
    /// Lehtinen, Akenine-Möller 2005, "Soft shadow volumes for ray tracing").
    Counted,
    /// Areas under the edges of the outlines that the light's middle sees are summed: no samples, but shadows that overlap
    /// add up (Assarsson, Akenine-Möller 2003, "A geometry-based soft shadow volume algorithm using graphics hardware").
    Summed,
}

/// Lines of samples on the light.
pub const N_LINES: usize = 16;
/// Samples of a line.
pub const N_COLUMNS: usize = 32;
/// Casters count from this share of the way from the light to as far before the lit place.
pub const CLEARANCE: f32 = 1e-4;
/// How far places are moved off their surface towards the eye, share of the casters' radius.
const LIFT: f32 = 2e-4;
/// Half edge of the square that stands for a light without extent, share of its distance.
const POINT: f32 = 2e-4;
/// Where the square stands that stands for a directional light, radii of the casters.
const FAR: f32 = 20.0;

/// A rectangle that shines towards `half_u_m` × `half_v_m`. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WedgeLight {
    /// Its middle.
    pub center_m: Vec3,
    /// Half its sides, perpendicular.
    pub half_m: [Vec3; 2],
    /// How far places are moved off their surface, towards the eye, so that they are on its seen side for sure.
    pub lift_m: f32,
}

impl WedgeLight {
    /// The rectangle itself, or one so small that its shadow looks hard, turned towards the casters.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] for a rectangle without area or with sides that are not perpendicular, and for a point light
    /// among the casters, which shines to all sides.
    pub fn new(light: &ShadowLight, casters: Sphere) -> Result<Self, RenderError> {
        let lift_m = LIFT * casters.radius_m.max(0.1);
        let facing = |center_m: Vec3, forward: Vec3, half_m: f32| {
            let [right, up] = basis(forward);
            Self {
                center_m,
                half_m: [half_m * right, half_m * up],
                lift_m,
            }
        };
        let rectangle = match *light {
            ShadowLight::Rect {
                center_m,
                half_u_m,
                half_v_m,
                ..
            } => {
                let area = half_u_m.length() * half_v_m.length();
                let is_rectangle = area.is_finite() && area > 0.0 && half_u_m.dot(half_v_m).abs() < 1e-3 * area;
                if !(is_rectangle && center_m.is_finite()) {
                    return Err(refusal(
                        format!("the sides {half_u_m} and {half_v_m} of the light make no rectangle"),
                        "give two perpendicular half sides, in metres",
                    ));
                }
                Self {
                    center_m,
                    half_m: [half_u_m, half_v_m],
                    lift_m,
                }
            }
            ShadowLight::Spot { position_m, axis, .. } => {
                facing(position_m, axis, POINT * position_m.distance(casters.center_m).max(0.1))
            }
            ShadowLight::Point { position_m, .. } => {
                let way = casters.center_m - position_m;
                let distance_m = way.length();
                if distance_m <= casters.radius_m {
                    return Err(refusal(
                        format!("the point light at {position_m} shines to all sides, a rectangle only to one"),
                        "move it away from the objects, give it a cone or an area, or choose stencil volumes",
                    ));
                }
                facing(position_m, way / distance_m, POINT * distance_m)
            }
            ShadowLight::Directional { towards, .. } => {
                let far_m = FAR * casters.radius_m;
                facing(casters.center_m + far_m * towards, -towards, POINT * far_m)
            }
        };
        Ok(rectangle)
    }

    /// World to the light's frame: z off its plane towards what it lights, metres; x and y on it, 0 ..= 1 each, or for
    /// counting [`N_COLUMNS`] wide and sheared so that lines of samples lie at whole y.
    #[must_use]
    pub fn light_from_world(&self, coverage: Coverage) -> Affine3A {
        let [u, v] = self.half_m;
        let forward = u.cross(v).normalize();
        let (across, along) = (0.5 * u / u.length_squared(), 0.5 * v / v.length_squared());
        let (x, y) = match coverage {
            Coverage::Summed => ((across, 0.5), (along, 0.5)),
            Coverage::Counted => (
                (N_COLUMNS as f32 * across, 0.5 * N_COLUMNS as f32),
                (N_LINES as f32 * along - across, 0.5 * N_LINES as f32 - 0.5),
            ),
        };
        let rows = Mat3A::from_cols(x.0.into(), y.0.into(), forward.into()).transpose();
        let middle = Vec3A::new(x.1, y.1, 0.0);
        Affine3A {
            matrix3: rows,
            translation: middle - rows * Vec3A::from(self.center_m),
        }
    }

    /// A place on the light, 0 ..= 1 along both sides.
    #[must_use]
    pub fn at(&self, [x, y]: [f32; 2]) -> Vec3 {
        self.center_m + (2.0 * x - 1.0) * self.half_m[0] + (2.0 * y - 1.0) * self.half_m[1]
    }
}

fn refusal(message: String, hint: &'static str) -> RenderError {
    RenderError::Shadow {
        method: "wedges",
        message,
        hint,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CASTERS: Sphere = Sphere {
        center_m: Vec3::ZERO,
        radius_m: 0.5,
    };

    fn rect(half_u_m: Vec3, half_v_m: Vec3) -> ShadowLight {
        ShadowLight::Rect {
            center_m: Vec3::new(0.3, -0.2, 2.0),
            half_u_m,
            half_v_m,
            radiance: Vec3::ONE,
        }
    }

    #[test]
    fn corners_of_the_light_are_corners_of_its_frame() {
        let light = WedgeLight::new(&rect(0.2 * Vec3::Y, 0.3 * Vec3::X), CASTERS).unwrap();
        let summed = light.light_from_world(Coverage::Summed);
        let counted = light.light_from_world(Coverage::Counted);
        for at in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.25, 0.75]] {
            let [x, y] = at;
            assert!((summed.transform_point3(light.at(at)) - Vec3::new(x, y, 0.0)).length() < 1e-5);
            let expected = Vec3::new(32.0 * x, 16.0 * y - x, 0.0);
            assert!((counted.transform_point3(light.at(at)) - expected).length() < 1e-4);
        }
        let below = light.at([0.5, 0.5]) + 0.7 * light.half_m[0].cross(light.half_m[1]).normalize();
        assert!((counted.transform_point3(below).z - 0.7).abs() < 1e-5);
    }

    #[test]
    fn what_is_no_rectangle_is_refused() {
        for (u, v) in [(Vec3::X, Vec3::ZERO), (Vec3::X, Vec3::X), (Vec3::X, Vec3::NAN)] {
            let refusal = WedgeLight::new(&rect(u, v), CASTERS).unwrap_err();
            assert!(refusal.to_string().contains("make no rectangle"), "{refusal}");
        }
        let among = ShadowLight::Point {
            position_m: Vec3::new(0.1, 0.0, 0.2),
            intensity: Vec3::ONE,
        };
        assert!(
            WedgeLight::new(&among, CASTERS)
                .unwrap_err()
                .to_string()
                .contains("to all sides")
        );
    }

    #[test]
    fn a_light_without_extent_is_a_small_square_that_faces_the_casters() {
        let lights = [
            ShadowLight::Point {
                position_m: Vec3::new(0.0, 0.0, 2.0),
                intensity: Vec3::ONE,
            },
            ShadowLight::Directional {
                towards: Vec3::Z,
                irradiance: Vec3::ONE,
            },
        ];
        for light in lights {
            let light = WedgeLight::new(&light, CASTERS).unwrap();
            assert!(light.half_m[0].cross(light.half_m[1]).normalize().dot(Vec3::NEG_Z) > 0.999);
            assert!(light.half_m[0].length() < 1e-3 * light.center_m.length());
        }
    }
}
