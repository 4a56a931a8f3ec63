//! What rays on the CPU say about a picture's shadows.

use glam::{Vec3, Vec4};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::{Lab, LabFrame, MAP_SIZE};
use mirrorball_render::scene::Mesh;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;

use crate::blocks;

/// A scene on the GPU, and its triangles.
pub(crate) struct Traced {
    pub(crate) lab: Lab,
    pub(crate) occluders: Occluders,
    size_px: [u32; 2],
}

impl Traced {
    pub(crate) fn new(meshes: &[(&str, Mesh)], view: &View) -> Self {
        let (scene, placements) = blocks::scene_of(meshes);
        let lab = Lab::new(Gpu::open().unwrap(), scene, placements, view).unwrap();
        let occluders = Occluders::new(lab.casters().triangles());
        Self {
            lab,
            occluders,
            size_px: view.size_px,
        }
    }

    /// A method's visibility of a light, per pixel.
    pub(crate) fn visibility(&mut self, method: ShadowMethod, light: &ShadowLight) -> Vec<f32> {
        self.lab.draw(&frame(method, light)).unwrap();
        self.lab.visibility().unwrap()
    }

    /// The same by `n` × `n` rays to places on the light; `None` where there is no surface or it turns away.
    pub(crate) fn truth(&mut self, light: &ShadowLight, n: u32) -> Vec<Option<f32>> {
        let picture = self.lab.picture(&frame(ShadowMethod::None, light)).unwrap();
        let places = self.lab.places().unwrap();
        let share = |place: Vec3| {
            let at = |i: u32| (i as f32 + 0.5) / n as f32 * 2.0 - 1.0;
            let n_open = (0..n * n)
                .filter(|i| {
                    let on_light = light.place_m([at(i % n), at(i / n)], place, 100.0);
                    !self.occluders.blocks(place, on_light)
                })
                .count();
            n_open as f32 / (n * n) as f32
        };
        let pixels = places.iter().zip(&picture.radiance);
        pixels
            .map(|(place, radiance)| (place.w > 0.0 && radiance.x > 0.0).then(|| share(place.truncate())))
            .collect()
    }

    /// Share of the pixels `of` chooses by place, not next to an edge of the true shadow, that a method has right.
    pub(crate) fn agreement(&mut self, method: ShadowMethod, light: &ShadowLight, of: impl Fn(Vec4) -> bool) -> f64 {
        let truth = self.truth(light, 1);
        let visibility = self.visibility(method, light);
        let places = self.lab.places().unwrap();
        let [width, height] = self.size_px.map(|s| s as usize);
        let (mut n, mut n_right) = (0u32, 0u32);
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                let at = y * width + x;
                let Some(expected) = truth[at].filter(|_| of(places[at])) else {
                    continue;
                };
                let around = [0, 1, 2].map(|row| (y + row - 1) * width + x - 1);
                if around
                    .iter()
                    .any(|&first| truth[first..first + 3].iter().any(|t| t.is_some_and(|t| t != expected)))
                {
                    continue;
                }
                n += 1;
                n_right += u32::from((visibility[at] > 0.5) == (expected > 0.5));
            }
        }
        assert!(n > 500, "only {n} pixels to compare");
        f64::from(n_right) / f64::from(n)
    }
}

/// A frame without ambient light.
pub(crate) fn frame(method: ShadowMethod, light: &ShadowLight) -> LabFrame<'_> {
    LabFrame {
        method,
        map_size: MAP_SIZE,
        light,
        ambient: Vec3::ZERO,
        refreshes_max: usize::MAX,
    }
}

/// A point, a spot and a directional light that shine onto the middle from the same side.
pub(crate) fn lights() -> [ShadowLight; 3] {
    let position_m = Vec3::new(0.7, 0.5, 1.3);
    [
        point(position_m),
        ShadowLight::Spot {
            position_m,
            axis: -position_m.normalize(),
            cone_rad: [0.4, 0.6],
            intensity: Vec3::ONE,
        },
        ShadowLight::Directional {
            towards: Vec3::new(-0.5, 0.3, 0.9).normalize(),
            irradiance: Vec3::ONE,
        },
    ]
}

pub(crate) fn point(position_m: Vec3) -> ShadowLight {
    ShadowLight::Point {
        position_m,
        intensity: Vec3::ONE,
    }
}
