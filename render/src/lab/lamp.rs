//! The one light of a scene without camera, of any kind, that can be moved.

use std::str::FromStr;

use glam::Vec3;

use crate::shadow::light::ShadowLight;
use crate::shadow::shadow_view::{Sphere, basis};

/// Half an edge of the rectangle, metres.
const HALF_EDGE_M: f32 = 0.2;
/// Half angles of a spot's cone within which it shines fully and beyond which not at all, radians.
const CONE_RAD: [f32; 2] = [0.55, 0.7];

/// Kinds of [`ShadowLight`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LampKind {
    /// From one place into all directions.
    Point,
    /// From one place into a cone.
    Spot,
    /// From far away.
    Directional,
    /// A rectangle of 0.4 × 0.4 m at the test scene.
    Rect,
}

impl LampKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Point, Self::Spot, Self::Directional, Self::Rect];

    /// Name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Spot => "spot",
            Self::Directional => "directional",
            Self::Rect => "rect",
        }
    }

    /// The kind after this one, going round.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|&kind| kind == self).unwrap_or(0);
        Self::ALL[(at + 1) % Self::ALL.len()]
    }
}

impl FromStr for LampKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            format!(
                "`{text}` is no kind of light; there are {}",
                Self::ALL.map(Self::name).join(", ")
            )
        })
    }
}

/// A lamp that shines on a place. All kinds light that place alike while the lamp is where it was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// Its kind.
    pub kind: LampKind,
    /// Where it stands, world, metres.
    pub position_m: Vec3,
    /// What it is turned to.
    pub target_m: Vec3,
    /// Irradiance at the target, perpendicular to the light, from where it was made.
    irradiance: Vec3,
    /// Its distance from the target there, metres.
    home_m: f32,
    /// Edge of its rectangle over that of the test scene's.
    scale: f32,
}

impl Lamp {
    /// The test scene's lamp: above on the left, so that the view sees the shadows.
    #[must_use]
    pub fn over_test_scene(kind: LampKind) -> Self {
        Self::new(kind, [Vec3::new(-0.48, -0.14, 1.12), Vec3::new(0.0, 0.0, 0.05)], 1.0)
    }

    /// A lamp over anything, as large and as far away in proportion as over the test scene.
    #[must_use]
    pub fn over(kind: LampKind, bounds: Sphere) -> Self {
        let scale = bounds.radius_m / 1.3;
        let position_m = bounds.center_m + scale * Vec3::new(-0.9, -0.3, 1.4);
        Self::new(kind, [position_m, bounds.center_m], scale)
    }

    fn new(kind: LampKind, [position_m, target_m]: [Vec3; 2], scale: f32) -> Self {
        Self {
            kind,
            position_m,
            target_m,
            irradiance: 2.5 * Vec3::new(1.05, 1.0, 0.9),
            home_m: position_m.distance(target_m),
            scale,
        }
    }

    /// Moves it, in steps of a fiftieth of its first distance; it stays above the height of its target.
    pub fn step(&mut self, steps: Vec3) {
        self.position_m += 0.02 * self.home_m * steps;
        self.position_m.z = self.position_m.z.max(self.target_m.z + 0.2 * self.home_m);
    }

    /// The light.
    #[must_use]
    pub fn light(&self) -> ShadowLight {
        let towards = (self.position_m - self.target_m).normalize_or(Vec3::Z);
        let intensity = self.irradiance * self.home_m * self.home_m;
        match self.kind {
            LampKind::Point => ShadowLight::Point {
                position_m: self.position_m,
                intensity,
            },
            LampKind::Spot => ShadowLight::Spot {
                position_m: self.position_m,
                axis: -towards,
                cone_rad: CONE_RAD,
                intensity,
            },
            LampKind::Directional => ShadowLight::Directional {
                towards,
                irradiance: self.irradiance,
            },
            LampKind::Rect => {
                let half_m = HALF_EDGE_M * self.scale;
                let across = basis(-towards)[0];
                ShadowLight::Rect {
                    center_m: self.position_m,
                    half_u_m: half_m * across,
                    half_v_m: half_m * (-towards).cross(across),
                    radiance: intensity / (4.0 * half_m * half_m),
                }
            }
        }
    }
}

/// Radiance of the light from everywhere, linear RGB: a quarter of what the lamp gives, bluish.
pub const AMBIENT: Vec3 = Vec3::new(0.2, 0.22, 0.25);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangle_shines_on_its_target_and_kinds_have_names() {
        for kind in LampKind::ALL {
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        assert!("lamp".parse::<LampKind>().unwrap_err().contains("point, spot"));
        let mut lamp = Lamp::over_test_scene(LampKind::Rect);
        let ShadowLight::Rect {
            center_m,
            half_u_m,
            half_v_m,
            radiance,
        } = lamp.light()
        else {
            unreachable!()
        };
        assert!(
            half_u_m
                .cross(half_v_m)
                .normalize()
                .dot((lamp.target_m - center_m).normalize())
                > 0.9999
        );
        let irradiance = radiance.y * 0.16 / center_m.distance_squared(lamp.target_m);
        assert!((irradiance - 2.5).abs() < 1e-3, "{irradiance}");
        lamp.step(Vec3::new(1.0, 0.0, -1000.0));
        assert!(lamp.position_m.z > lamp.target_m.z);
    }
}
