//! Buffers between the passes, drawn small into the finished picture: to see what each pass has made.

use std::str::FromStr;

use crate::camera_view::CameraView;
use crate::environments::Environments;
use crate::eye::Eye;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::node::Pictures;
use crate::passes::inset::{How, Inset};
use mirrorball_calib::probe::cube::FACES;

/// Where the buffers are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sources<'a> {
    /// The eye whose picture shows them.
    pub(crate) eye: &'a Eye,
    /// What the scene camera sees.
    pub(crate) seen: &'a CameraView,
    pub(crate) environments: &'a Environments,
    pub(crate) pictures: &'a Pictures,
}

/// A buffer's name, what it holds and where it is.
type Row = (&'static str, How, fn(&Sources<'_>) -> wgpu::TextureView);

/// All buffers that can be shown; a new one takes one line.
const ROWS: &[Row] = &[
    ("phantom-place", How::Place, |s| flat(&s.eye.light_on[0].place)),
    ("phantom-normal", How::Normal, |s| flat(&s.eye.light_on[0].normal)),
    ("phantom-light-without", How::Irradiance, |s| {
        flat(&s.eye.light_on[0].without)
    }),
    ("phantom-light-with", How::Irradiance, |s| {
        flat(&s.eye.light_on[0].with_virtual)
    }),
    ("phantom-lamps", How::Irradiance, |s| flat(&s.eye.light_on[0].lamps)),
    ("phantom-near", How::Change, |s| flat(&s.eye.light_on[0].near)),
    ("virtual-place", How::Place, |s| flat(&s.eye.light_on[1].place)),
    ("virtual-normal", How::Normal, |s| flat(&s.eye.light_on[1].normal)),
    ("virtual-light-without", How::Irradiance, |s| {
        flat(&s.eye.light_on[1].without)
    }),
    ("virtual-light-with", How::Irradiance, |s| {
        flat(&s.eye.light_on[1].with_virtual)
    }),
    ("virtual-lamps", How::Irradiance, |s| flat(&s.eye.light_on[1].lamps)),
    ("virtual-near", How::Irradiance, |s| flat(&s.eye.light_on[1].near)),
    ("ratio", How::Ratio, |s| flat(s.eye.receive.ratio())),
    ("real", How::Radiance, |s| flat(s.eye.real.radiance())),
    ("virtual", How::Radiance, |s| flat(s.eye.shade.radiance())),
    ("coverage", How::Coverage, |s| flat(s.eye.shade.radiance())),
    ("camera-place", How::Place, |s| flat(s.seen.phantoms.views().place)),
    ("light", How::Radiance, |s| cube(&s.pictures.radiance.view)),
    ("room", How::Radiance, |s| cube(&s.pictures.far.view)),
    ("behind-lights", How::Radiance, |s| cube(&s.pictures.behind.view)),
    ("environment", How::Radiance, |s| cube_of(&s.environments.radiance)),
    ("specular", How::Radiance, |s| cube_of(&s.environments.specular)),
];

/// A buffer that can be shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Buffer(usize);

impl Buffer {
    /// All buffers, in the order in which a window's key goes through them.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..ROWS.len()).map(Self)
    }

    /// Name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        ROWS[self.0].0
    }

    /// The buffer after this one; `None` after the last.
    #[must_use]
    pub fn next(self) -> Option<Self> {
        Self::all().nth(self.0 + 1)
    }
}

impl FromStr for Buffer {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::all().find(|buffer| buffer.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Self::all().map(Self::name).collect();
            format!("`{text}` is no buffer; there are {}", names.join(", "))
        })
    }
}

/// The buffers that are shown, in the first eye's picture, from its top left in rows of [`Inset::PER_EDGE`].
#[derive(Debug, Default)]
pub struct Insets {
    buffers: Vec<Buffer>,
    passes: Vec<Inset>,
}

impl Insets {
    /// Buffers at most: as many as have a place in the picture.
    pub const MOST: usize = (Inset::PER_EDGE * Inset::PER_EDGE) as usize;

    /// Shows `buffers`; what is beyond [`Insets::MOST`] is left out.
    pub(crate) fn new(gpu: &Gpu, buffers: &[Buffer], sources: &Sources<'_>) -> Self {
        let buffers = &buffers[..buffers.len().min(Self::MOST)];
        let view = sources.eye.own.as_ref().map_or(sources.seen, |own| &own.view);
        let picture = (&view.camera, sources.eye.finish.codes());
        let passes = buffers.iter().zip(0..).map(|(buffer, index)| {
            let (_, how, source) = ROWS[buffer.0];
            Inset::new(gpu, picture, (&source(sources), how), index)
        });
        Self {
            passes: passes.collect(),
            buffers: buffers.to_vec(),
        }
    }

    /// What is shown.
    #[must_use]
    pub fn buffers(&self) -> &[Buffer] {
        &self.buffers
    }

    /// Draws them over the finished picture.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        for pass in &self.passes {
            pass.record(encoder, timer);
        }
    }
}

/// The first layer and mip of a texture.
fn flat(view: &wgpu::TextureView) -> wgpu::TextureView {
    layers(view.texture(), 1)
}

/// The six faces of a cube.
fn cube(view: &wgpu::TextureView) -> wgpu::TextureView {
    layers(view.texture(), FACES as u32)
}

/// The six faces of the first of several cubes.
fn cube_of(texture: &wgpu::Texture) -> wgpu::TextureView {
    layers(texture, FACES as u32)
}

fn layers(texture: &wgpu::Texture, n: u32) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        label: Some("inset: source"),
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        mip_level_count: Some(1),
        array_layer_count: Some(n),
        ..wgpu::TextureViewDescriptor::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back_and_a_wrong_one_lists_all() {
        for buffer in Buffer::all() {
            assert_eq!(buffer.name().parse(), Ok(buffer));
        }
        let message = "depht".parse::<Buffer>().unwrap_err();
        assert!(
            message.starts_with("`depht` is no buffer; there are phantom-place, phantom-normal,"),
            "{message}"
        );
        let mut at = Buffer::all().next();
        for _ in Buffer::all() {
            at = at.and_then(Buffer::next);
        }
        assert_eq!(at, None);
    }
}
