//! Modes: for how many eyes the picture is made, and what stands around the virtual objects in it.

use std::fmt;
use std::str::FromStr;

/// What is shown, and to how many eyes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// The scene camera's own picture with the virtual objects in it.
    #[default]
    SeeThrough,
    /// The same for two eyes, side by side: the camera's picture as each of them would see it.
    Stereo,
    /// The virtual objects alone, lit by the light of the room, before a colour or the measured light.
    Vr,
    /// The same for two eyes, side by side.
    VrStereo,
    /// For a display that one looks through: black where nothing is added to what the eye sees by itself.
    Optical,
    /// The same for two eyes, side by side.
    OpticalStereo,
}

/// What stands around the virtual objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surround {
    /// The camera's picture.
    Picture,
    /// A colour or the measured light.
    Backdrop,
    /// Nothing: black.
    Nothing,
}

/// Who looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Viewers {
    /// The scene camera, through its own lens.
    Camera,
    /// One eye where the scene camera is, without a lens.
    OneEye,
    /// Two eyes beside the scene camera.
    TwoEyes,
}

impl Mode {
    /// All modes.
    pub const ALL: [Self; 6] = [
        Self::SeeThrough,
        Self::Stereo,
        Self::Vr,
        Self::VrStereo,
        Self::Optical,
        Self::OpticalStereo,
    ];

    /// Name in configuration files, on the command line and in `frames.jsonl`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SeeThrough => "see-through",
            Self::Stereo => "stereo",
            Self::Vr => "vr",
            Self::VrStereo => "vr-stereo",
            Self::Optical => "optical",
            Self::OpticalStereo => "optical-stereo",
        }
    }

    /// What stands around the virtual objects.
    #[must_use]
    pub fn surround(self) -> Surround {
        match self {
            Self::SeeThrough | Self::Stereo => Surround::Picture,
            Self::Vr | Self::VrStereo => Surround::Backdrop,
            Self::Optical | Self::OpticalStereo => Surround::Nothing,
        }
    }

    /// Who looks.
    #[must_use]
    pub fn viewers(self) -> Viewers {
        match self {
            Self::SeeThrough => Viewers::Camera,
            Self::Vr | Self::Optical => Viewers::OneEye,
            Self::Stereo | Self::VrStereo | Self::OpticalStereo => Viewers::TwoEyes,
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Mode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|mode| mode.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name);
            format!("`{text}` is no mode; there are {}", names.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back_and_a_wrong_one_lists_all() {
        for mode in Mode::ALL {
            assert_eq!(mode.name().parse(), Ok(mode));
        }
        let message = "3d".parse::<Mode>().unwrap_err();
        assert_eq!(
            message,
            "`3d` is no mode; there are see-through, stereo, vr, vr-stereo, optical, optical-stereo"
        );
    }
}
