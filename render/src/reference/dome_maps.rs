//! Depth as a light of a dome sees it, by casting a ray through every texel.

use crate::scene::occluders::Occluders;
use crate::shadow::shadow_view::ShadowView;

/// The map of `size` × `size` texels that `view` has of `casters`, rows from the top: 1 at the near plane, 0 at the far one and
/// where nothing is.
#[must_use]
pub fn stored_depth(view: &ShadowView, casters: &Occluders, size: u32) -> Vec<f32> {
    let [right, up, forward] = view.axes;
    let texel = |index: u32| {
        let ndc = |t: u32| (t as f32 + 0.5) / size as f32 * 2.0 - 1.0;
        let (x, y) = (ndc(index % size), -ndc(index / size));
        let direction = (forward + (right * x + up * y) * view.tangent).normalize();
        casters
            .distance_m(view.position_m, direction, 0.0)
            .map_or(0.0, |distance| {
                1.0 - view.project(view.position_m + direction * distance).z
            })
    };
    (0..size * size).map(texel).collect()
}
