//! Truth for the shadow of a rectangular light: rays to 32 × 32 samples.

use glam::{Affine3A, Vec3, Vec4};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::{Lab, LabFrame, MAP_SIZE};
use mirrorball_render::reference::shadow_wedges::Receiver;
use mirrorball_render::scene::Mesh;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;
use rayon::prelude::*;

use crate::blocks;

/// Size of most test pictures.
pub(crate) const SIZE_PX: [u32; 2] = [96, 72];
/// Samples along each side of the light.
const N_SIDE: u32 = 32;

/// A rectangle that shines down.
pub(crate) fn lamp(center_m: Vec3, half_m: [f32; 2]) -> ShadowLight {
    ShadowLight::Rect {
        center_m,
        half_u_m: half_m[1] * Vec3::Y,
        half_v_m: half_m[0] * Vec3::X,
        radiance: Vec3::ONE,
    }
}

/// A scene, and the eye's place and what it looks at.
pub(crate) struct Stage {
    pub(crate) lab: Lab,
    pub(crate) map_size: u32,
    rays: Rays,
    size_px: [u32; 2],
}

/// What rays need to know.
struct Rays {
    eye_m: Vec3,
    triangles: Vec<[Vec3; 3]>,
    occluders: Occluders,
}

impl Stage {
    pub(crate) fn new(meshes: &[(&str, Mesh)], [eye_m, target_m]: [Vec3; 2], size_px: [u32; 2]) -> Self {
        let placements = vec![Affine3A::IDENTITY; meshes.len()];
        Self::placed(meshes, placements, [eye_m, target_m], size_px)
    }

    pub(crate) fn placed(
        meshes: &[(&str, Mesh)],
        placements: Vec<Affine3A>,
        [eye_m, target_m]: [Vec3; 2],
        size_px: [u32; 2],
    ) -> Self {
        let (scene, _) = blocks::scene_of(meshes);
        let view = View::looking_at(eye_m, target_m, 0.9, size_px);
        let lab = Lab::new(Gpu::open().unwrap(), scene, placements, &view).unwrap();
        let triangles: Vec<[Vec3; 3]> = lab.casters().triangles().collect();
        let rays = Rays {
            eye_m,
            occluders: Occluders::new(triangles.iter().copied()),
            triangles,
        };
        Self {
            lab,
            map_size: MAP_SIZE,
            rays,
            size_px,
        }
    }

    /// The share of the light that a method lets arrive.
    pub(crate) fn drawn(&mut self, method: ShadowMethod, light: &ShadowLight) -> Vec<f32> {
        let frame = LabFrame {
            method,
            map_size: self.map_size,
            light,
            ambient: Vec3::ZERO,
            refreshes_max: usize::MAX,
        };
        self.lab.draw(&frame).unwrap();
        let visibility = self.lab.visibility().unwrap();
        assert!(visibility.iter().all(|v| (0.0..=1.0).contains(v)), "{method:?}");
        if let Ok(folder) = std::env::var("SHADOW_PICTURES") {
            let name = std::thread::current().name().unwrap_or("test").replace("::", "_");
            self.write(&visibility, &format!("{folder}/{name}_{}.png", method.name()));
        }
        visibility
    }

    /// Places and normals of all pixels with a surface.
    pub(crate) fn receivers(&self) -> Vec<Option<Receiver>> {
        let receiver = |place: &Vec4| Receiver {
            place_m: place.truncate(),
            normal: self.rays.normal(place.truncate()),
            eye_m: self.rays.eye_m,
        };
        let places = self.lab.places().unwrap();
        places
            .iter()
            .map(|place| (place.w > 0.0).then(|| receiver(place)))
            .collect()
    }

    fn write(&self, visibility: &[f32], path: &str) {
        let [width, height] = self.size_px;
        let bytes = visibility.iter().map(|v| (255.0 * v + 0.5) as u8).collect();
        image::GrayImage::from_raw(width, height, bytes)
            .unwrap()
            .save(path)
            .unwrap();
    }

    /// The same by rays, each sample as bright as the surface sees it; nothing where the surface turns away or none is.
    pub(crate) fn truth(&self, light: &ShadowLight) -> Vec<Option<f32>> {
        let (places, rays) = (self.lab.places().unwrap(), &self.rays);
        let truth: Vec<Option<f32>> = places
            .par_iter()
            .map(|place| (place.w > 0.0).then(|| rays.lit_share(*place, light)).flatten())
            .collect();
        if let Ok(folder) = std::env::var("SHADOW_PICTURES") {
            let name = std::thread::current().name().unwrap_or("test").replace("::", "_");
            let shares: Vec<f32> = truth.iter().map(|share| share.unwrap_or(1.0)).collect();
            self.write(&shares, &format!("{folder}/{name}_truth.png"));
        }
        truth
    }
}

impl Rays {
    fn lit_share(&self, place: Vec4, light: &ShadowLight) -> Option<f32> {
        let (place, normal) = (place.truncate(), self.normal(place.truncate()));
        let (mut all, mut arriving) = (0.0, 0.0);
        let mut state = place.x.to_bits() ^ place.y.to_bits().rotate_left(11) ^ place.z.to_bits().rotate_left(22);
        let mut jittered = |i: u32| {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
            2.0 * (i as f32 + (word >> 8) as f32 / (1 << 24) as f32) / N_SIDE as f32 - 1.0
        };
        for i in 0..N_SIDE {
            for j in 0..N_SIDE {
                let at = light.place_m([jittered(i), jittered(j)], place, 0.0);
                let way = at - place;
                let weight = way.dot(normal).max(0.0) / way.length_squared().powi(2);
                all += weight;
                if weight > 0.0 && !self.occluders.blocks(place, at) {
                    arriving += weight;
                }
            }
        }
        (all > 0.0).then(|| arriving / all)
    }

    /// Normal of the triangle that a place is on, towards the eye.
    fn normal(&self, place: Vec3) -> Vec3 {
        let off = |&[a, b, c]: &[Vec3; 3]| {
            let normal = (b - a).cross(c - a).normalize();
            let outside = [(a, b), (b, c), (c, a)]
                .map(|(from, to)| normal.cross(to - from).normalize().dot(from - place))
                .into_iter()
                .fold(0.0, f32::max);
            normal.dot(place - a).abs() + outside
        };
        let nearest = self.triangles.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        let normal = (nearest[1] - nearest[0]).cross(nearest[2] - nearest[0]).normalize();
        if normal.dot(self.eye_m - place) < 0.0 {
            -normal
        } else {
            normal
        }
    }
}

/// Peak signal to noise ratio, decibels, where the truth is known.
pub(crate) fn psnr_db(drawn: &[f32], truth: &[Option<f32>]) -> f32 {
    let squares: Vec<f32> = (drawn.iter().zip(truth))
        .filter_map(|(drawn, truth)| truth.map(|truth| (drawn - truth).powi(2)))
        .collect();
    let mean = squares.iter().sum::<f32>() / squares.len() as f32;
    -10.0 * mean.max(1e-12).log10()
}
