//! Depth as a light sees it, by casting a ray through every texel.

use crate::passes::shadow_map::ShadowView;
use crate::scene::occluders::Occluders;

/// A square depth map: 0 at the near plane, 1 at the far one and where nothing is.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    /// Edge in texels.
    pub size: u32,
    /// Depths, rows from the top.
    pub texels: Vec<f32>,
}

impl DepthMap {
    /// Depth at a column and row; beyond the edge that of the nearest texel.
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let last = (self.size - 1) as f32;
        self.texels[y.clamp(0.0, last) as usize * self.size as usize + x.clamp(0.0, last) as usize]
    }
}

/// The depth map that `view` has of `casters`.
#[must_use]
pub fn depth(view: &ShadowView, casters: &Occluders, size: u32) -> DepthMap {
    let [right, up, forward] = view.axes;
    let texel = |index: u32| {
        let ndc = |t: u32| (t as f32 + 0.5) / size as f32 * 2.0 - 1.0;
        let (x, y) = (ndc(index % size), -ndc(index / size));
        let direction = (forward + (right * x + up * y) * view.tangent).normalize();
        casters
            .distance_m(view.position_m, direction, 0.0)
            .map_or(1.0, |distance| view.project(view.position_m + direction * distance).z)
    };
    DepthMap {
        size,
        texels: (0..size * size).map(texel).collect(),
    }
}
