//! The list of methods.

use std::str::FromStr;

use super::area::{AreaShadow, N_REFERENCE};
use super::attenuation::AttenuationMaps;
use super::blob::BlobShadow;
use super::haller::HallerShadow;
use super::key::KeyShadow;
use super::pcf::{PcfShadow, Taps};
use super::pcss::PcssShadow;
use super::planar::PlanarShadow;
use super::volume::{Counting, VolumeShadow};
use super::wedge_light::Coverage;
use super::wedges::Wedges;
use crate::error::RenderError;
use crate::gpu::Gpu;

/// A way to draw shadows. The ids are those of `ARCHITECTURE.md`, "Shadows".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum ShadowMethod {
    /// All light arrives everywhere.
    None,
    /// A dark spot under every object (D1).
    Blob,
    /// Casters projected onto the receivers' planes, stencilled (D2).
    Planar,
    /// The same from several places on the light, blended (D3).
    SoftPlanar,
    /// Stencil shadow volumes counted from the eye (D4).
    VolumeZPass,
    /// Stencil shadow volumes counted from infinity, right wherever the eye is (D4).
    VolumeZFail,
    /// Haller's order of stencil volumes for real and virtual things (E7).
    Haller,
    /// Shadow map, one comparison (D5, D6).
    Map,
    /// Shadow map, 3 × 3 comparisons (D7).
    Pcf9,
    /// Shadow map, 5 × 5 comparisons (D7).
    Pcf25,
    /// Shadow map, 7 × 7 comparisons (D7).
    Pcf49,
    /// Shadow map, filter as wide as the penumbra (D8).
    Pcss,
    /// Soft shadow volumes with penumbra wedges, light samples counted (D9).
    Wedges,
    /// The same with areas summed, as first published: shadows that overlap add up (D9).
    WedgesSummed,
    /// Layered attenuation maps (D17).
    AttenuationMaps,
    /// Many hard shadows from places all over an area light: the reference of one light (D16).
    Area,
    /// 16 lights over the dome, hard shadows (D10).
    Dome16,
    /// 64 lights over the dome, hard shadows (D10).
    Dome64,
    /// 256 lights over the dome, hard shadows (D10).
    Dome256,
    /// One light set by hand, the rest ambient (D11).
    Hand,
    /// Dome without lights too dim to see, each at the brightest spot of its cell, each shadow soft (D13).
    DomeImproved,
    /// The seeds' darkening, its strength following the scene's brightness (D14).
    BaseBrightness,
    /// The light from everywhere alike (D15).
    AmbientOcclusion,
    /// A fixed dome and lights that follow the bright regions, penumbrae by solid angle.
    Stable,
    /// Paths traced through the scene: the reference of all light, off line (D18).
    PathTraced,
}

/// How a method works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// One light's shadow over unshadowed ambient light.
    Key,
    /// Many lights over the sphere.
    Dome,
    /// Off-line reference.
    Path,
}

impl ShadowMethod {
    /// All methods, in the order in which a window's key goes through them.
    pub const ALL: [Self; 25] = [
        Self::None,
        Self::Blob,
        Self::Planar,
        Self::SoftPlanar,
        Self::VolumeZPass,
        Self::VolumeZFail,
        Self::Haller,
        Self::Map,
        Self::Pcf9,
        Self::Pcf25,
        Self::Pcf49,
        Self::Pcss,
        Self::Wedges,
        Self::WedgesSummed,
        Self::AttenuationMaps,
        Self::Area,
        Self::Dome16,
        Self::Dome64,
        Self::Dome256,
        Self::Hand,
        Self::DomeImproved,
        Self::BaseBrightness,
        Self::AmbientOcclusion,
        Self::Stable,
        Self::PathTraced,
    ];

    /// Name in configuration files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Blob => "blob",
            Self::Planar => "planar",
            Self::SoftPlanar => "soft-planar",
            Self::VolumeZPass => "volume-zpass",
            Self::VolumeZFail => "volume-zfail",
            Self::Haller => "haller",
            Self::Map => "map",
            Self::Pcf9 => "pcf9",
            Self::Pcf25 => "pcf25",
            Self::Pcf49 => "pcf49",
            Self::Pcss => "pcss",
            Self::Wedges => "wedges",
            Self::WedgesSummed => "wedges-summed",
            Self::AttenuationMaps => "attenuation-maps",
            Self::Area => "area",
            Self::Dome16 => "dome16",
            Self::Dome64 => "dome64",
            Self::Dome256 => "dome256",
            Self::Hand => "hand",
            Self::DomeImproved => "dome-improved",
            Self::BaseBrightness => "base-brightness",
            Self::AmbientOcclusion => "ambient-occlusion",
            Self::Stable => "stable",
            Self::PathTraced => "path",
        }
    }

    /// How it works.
    #[must_use]
    pub fn family(self) -> Family {
        match self {
            Self::Dome16
            | Self::Dome64
            | Self::Dome256
            | Self::Hand
            | Self::DomeImproved
            | Self::BaseBrightness
            | Self::AmbientOcclusion
            | Self::Stable => Family::Dome,
            Self::PathTraced => Family::Path,
            _ => Family::Key,
        }
    }

    /// The method after this one, going round.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|&m| m == self).unwrap_or(0);
        Self::ALL[(at + 1) % Self::ALL.len()]
    }

    /// The passes of a one-light method, with shadow maps of `map_size` texels where it has any; `None` for other
    /// families and for [`ShadowMethod::None`].
    ///
    /// # Errors
    /// [`RenderError::Shadow`] where this adapter cannot.
    pub fn key_shadow(self, gpu: &Gpu, map_size: u32) -> Result<Option<Box<dyn KeyShadow>>, RenderError> {
        Ok(match self {
            Self::Blob => Some(Box::new(BlobShadow::new(gpu))),
            Self::Planar => Some(Box::new(PlanarShadow::new(gpu, PlanarShadow::HARD))),
            Self::SoftPlanar => Some(Box::new(PlanarShadow::new(gpu, PlanarShadow::SOFT))),
            Self::VolumeZPass => Some(Box::new(VolumeShadow::new(gpu, Counting::InFront))),
            Self::VolumeZFail => Some(Box::new(VolumeShadow::new(gpu, Counting::Behind))),
            Self::Haller => Some(Box::new(HallerShadow::new(gpu))),
            Self::Wedges => Some(Box::new(Wedges::new(gpu, Coverage::Counted))),
            Self::WedgesSummed => Some(Box::new(Wedges::new(gpu, Coverage::Summed))),
            Self::AttenuationMaps => Some(Box::new(AttenuationMaps::new(gpu, map_size)?)),
            Self::Map => Some(Box::new(PcfShadow::new(gpu, map_size, Taps::One))),
            Self::Pcf9 => Some(Box::new(PcfShadow::new(gpu, map_size, Taps::Nine))),
            Self::Pcf25 => Some(Box::new(PcfShadow::new(gpu, map_size, Taps::TwentyFive))),
            Self::Pcf49 => Some(Box::new(PcfShadow::new(gpu, map_size, Taps::FortyNine))),
            Self::Pcss => Some(Box::new(PcssShadow::new(gpu, map_size))),
            Self::Area => Some(Box::new(AreaShadow::new(gpu, map_size, N_REFERENCE))),
            _ => None,
        })
    }
}

impl FromStr for ShadowMethod {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|m| m.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|m| m.name()).collect();
            format!("`{text}` is no shadow method; there are {}", names.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back() {
        for method in ShadowMethod::ALL {
            assert_eq!(method.name().parse(), Ok(method));
        }
        assert!("pcf10".parse::<ShadowMethod>().unwrap_err().contains("pcf9, pcf25"));
        let mut method = ShadowMethod::None;
        for _ in ShadowMethod::ALL {
            method = method.next();
        }
        assert_eq!(method, ShadowMethod::None);
    }
}
