//! What a picture of a shadow should hold: rays from its surfaces, and measures of the difference.

use glam::{Vec3, Vec4};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::{Lab, LabFrame};
use mirrorball_render::reference::shadow_rays::share_lit;
use mirrorball_render::scene::Mesh;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;

use crate::blocks;

/// Visibility of every pixel, and its place with the plane's normal where there is a surface.
pub(crate) struct Seen {
    pub(crate) visibility: Vec<f32>,
    pub(crate) surfaces: Vec<Option<(Vec3, Vec3)>>,
    pub(crate) occluders: Occluders,
}

/// A scene of flat-sided meshes.
pub(crate) fn lab(meshes: &[(&str, Mesh)], view: &View) -> Lab {
    let (scene, placements) = blocks::scene_of(meshes);
    Lab::new(Gpu::open().unwrap(), scene, placements, view).unwrap()
}

/// Draws with a method.
pub(crate) fn draw(lab: &mut Lab, light: &ShadowLight, (method, map_size): (ShadowMethod, u32), eye_m: Vec3) -> Seen {
    let frame = LabFrame {
        method,
        map_size,
        light,
        ambient: Vec3::ZERO,
        refreshes_max: usize::MAX,
    };
    lab.draw(&frame).unwrap();
    let occluders = Occluders::new(lab.casters().triangles());
    let places = lab.places().unwrap();
    Seen {
        visibility: lab.visibility().unwrap(),
        surfaces: places
            .iter()
            .map(|&place| surface_at(&occluders, place, eye_m))
            .collect(),
        occluders,
    }
}

/// The triangle on which a place lies, by its normal on the eye's side.
fn surface_at(occluders: &Occluders, place: Vec4, eye_m: Vec3) -> Option<(Vec3, Vec3)> {
    const NEAR_M: f32 = 1e-4;
    let point = place.truncate();
    let holds = |[a, b, c]: &[Vec3; 3]| {
        let normal = (*b - *a).cross(*c - *a).normalize();
        let is_inside = [(a, b), (b, c), (c, a)]
            .iter()
            .all(|(from, to)| (**to - **from).normalize().cross(point - **from).dot(normal) > -NEAR_M);
        (is_inside && normal.dot(point - *a).abs() < NEAR_M).then_some(normal)
    };
    // The side seen best, where two meet.
    let towards = (eye_m - point).normalize();
    let seen = |normal: Vec3| if normal.dot(towards) < 0.0 { -normal } else { normal };
    (place.w > 0.0)
        .then(|| occluders.triangles().iter().filter_map(holds).map(seen))?
        .max_by(|a, b| a.dot(towards).total_cmp(&b.dot(towards)))
        .map(|normal| (point, normal))
}

impl Seen {
    /// Truth per pixel with surface.
    pub(crate) fn truth(&self, light: &ShadowLight, n_per_side: u32) -> Vec<Option<f32>> {
        let share = |surface: (Vec3, Vec3)| share_lit(light, &self.occluders, surface, n_per_side);
        self.surfaces.iter().map(|surface| surface.map(share)).collect()
    }

    /// Pixels, of those farther than `rim_m` from any edge of the shadow, and how many agree with truth within `within`.
    pub(crate) fn agreement(&self, light: &ShadowLight, rim_m: f32, within: f32) -> (usize, usize) {
        let share = |surface| share_lit(light, &self.occluders, surface, 1);
        let (mut n, mut n_right) = (0, 0);
        for (visibility, surface) in self.visibility.iter().zip(&self.surfaces) {
            let Some((point, normal)) = *surface else { continue };
            let truth = share((point, normal));
            let u = normal.any_orthonormal_vector();
            let v = normal.cross(u);
            let is_edge = (0..8)
                .map(|i| (std::f32::consts::FRAC_PI_4 * i as f32).sin_cos())
                .any(|(sine, cosine)| share((point + rim_m * (cosine * u + sine * v), normal)) != truth);
            if !is_edge {
                n += 1;
                n_right += usize::from((visibility - truth).abs() <= within);
            }
        }
        (n, n_right)
    }

    /// Peak signal to noise ratio against truth, dB.
    pub(crate) fn psnr_db(&self, truth: &[Option<f32>]) -> f64 {
        let errors: Vec<f64> = self
            .visibility
            .iter()
            .zip(truth)
            .filter_map(|(visibility, truth)| truth.map(|truth| f64::from(visibility - truth).powi(2)))
            .collect();
        -10.0 * (errors.iter().sum::<f64>() / errors.len() as f64).log10()
    }
}
