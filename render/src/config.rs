//! The render node's settings: `configs/render.toml`.

use std::path::Path;
use std::str::FromStr;

use mirrorball_calib::lights::LightMethod;
use mirrorball_calib::probe::Trust;
use mirrorball_calib::probe::mapping::Mapping;
use serde::Deserialize;

use crate::error::RenderError;
use crate::mode::Mode;
use crate::shadow::ShadowMethod;

/// All settings; every key has a default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderConfig {
    /// The light probe.
    pub probe: ProbeConfig,
    /// How lights are found in the light, and how it reaches virtual objects.
    pub light: LightConfig,
    /// Lights and their shadows.
    pub shadow: ShadowConfig,
    /// Near and far planes of the picture.
    pub view: ViewConfig,
    /// What is shown, and to how many eyes.
    pub mode: ModeConfig,
    /// What virtual pixels have of the camera.
    pub look: LookConfig,
}

/// How the probe's picture becomes light.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProbeConfig {
    /// Edge of a radiance cube's face in texels; a multiple of 16, 32 ..= 512.
    pub cube_size: u32,
    /// Distance from the probe to the room where nothing measures it, metres, 0.5 ..= 100.
    pub room_distance_m: f32,
    /// Directions within this distance of the camera's own image in the ball are left out, metres, 0 ..= 0.5.
    pub camera_radius_m: f32,
    /// Cosine of the flattest reflection that is trusted, 0.02 ..= 0.9.
    pub min_view_cosine: f32,
    /// How directions become places in the picture.
    pub mapping: MappingName,
    /// Share of the surroundings that the simple mapping takes the picture to show, 0 ..= 1; see [`Mapping::Simple`].
    pub wrap: f32,
    /// Frames over which a still environment is averaged, 1 ..= 64; 1 switches averaging off.
    pub average_frames: u32,
    /// Relative change of a texel's luminance that counts as new light, above 0.
    pub change_ratio: f32,
    /// Whether the ball's outline in the pictures corrects its place.
    pub outline: Outline,
    /// Whether the scene camera's picture shows what no probe sees.
    pub scene_camera: SceneCamera,
}

/// How directions become places in the probe's picture, by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MappingName {
    /// [`Mapping::Exact`].
    #[default]
    Exact,
    /// [`Mapping::Simple`], with the key `wrap`.
    Simple,
}

/// What the scene camera's picture is used for beside papers and phantoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneCamera {
    /// It shows what no probe sees, before the nearest known light stands in for it, and the room to rays that virtual
    /// objects mirror or refract.
    Fills,
    /// Nothing: light comes from the probe alone, for rays that meet no real thing as well.
    Ignored,
}

/// What the ball's outline is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outline {
    /// It corrects the ball's place.
    Corrects,
    /// Nothing: the rig file is exact.
    Ignored,
}

impl ProbeConfig {
    /// How directions become places in the probe's picture.
    #[must_use]
    pub fn mapping(&self) -> Mapping {
        match self.mapping {
            MappingName::Exact => Mapping::Exact,
            MappingName::Simple => Mapping::Simple {
                wrap: f64::from(self.wrap),
            },
        }
    }

    /// What of the probe's picture is not trusted.
    #[must_use]
    pub fn trust(&self) -> Trust {
        Trust {
            min_view_cosine: self.min_view_cosine,
            camera_radius_m: self.camera_radius_m,
        }
    }
}

impl Default for ProbeConfig {
    fn default() -> Self {
        Self {
            cube_size: 128,
            room_distance_m: 2.0,
            camera_radius_m: 0.05,
            min_view_cosine: 0.1,
            mapping: MappingName::Exact,
            wrap: 1.0,
            average_frames: 8,
            change_ratio: 0.08,
            outline: Outline::Corrects,
            scene_camera: SceneCamera::Fills,
        }
    }
}

/// How lights are found in the light, and how the light of an environment reaches the virtual object in its middle.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightConfig {
    /// How lights are found in the light: `stable`, `median_cut` or `regions`.
    pub extraction: LightMethod,
    /// Light on matt surfaces.
    pub diffuse: DiffuseMethod,
    /// Reflections.
    pub specular: SpecularMethod,
    /// How often light is scattered between the facets of rough surfaces.
    pub facets: Facets,
    /// Means of the light above which `specular = "highlight"` keeps it, 0 ..= 1000.
    pub highlight_threshold: f32,
}

impl Default for LightConfig {
    fn default() -> Self {
        Self {
            extraction: LightMethod::Stable,
            diffuse: DiffuseMethod::Lights,
            specular: SpecularMethod::Rays,
            facets: Facets::Single,
            highlight_threshold: 4.0,
        }
    }
}

/// Where the light on matt surfaces comes from.
///
/// All methods but the first read irradiance off a map of the object's own environment, near things included, and
/// multiply it by the share of the lights that virtual objects let through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DiffuseMethod {
    /// Lights, each with its shadows, and harmonics of near things.
    Lights,
    /// Cosine convolution of the environment, exact.
    CosineCube,
    /// Spherical harmonics of the environment to order 2.
    Sh9,
    /// Faces of the environment blurred as pictures (Supan 2006).
    SeparableBlur,
    /// The environment turned about three axes (Supan 2006).
    Cylindrical,
    /// Sphere map in eye space of the cosine convolution (Supan 2006).
    SphereMap,
}

/// Where reflections come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpecularMethod {
    /// Rays through real and virtual things, and the room behind them.
    Rays,
    /// Map of GGX lobes, one per roughness.
    Ggx,
    /// Phong lobes, one per exponent.
    Phong,
    /// Phong lobes of what is brighter than `highlight_threshold` alone, for plastics.
    Highlight,
    /// Sphere map in eye space, without roughness and parallax (Supan 2006).
    SphereMap,
    /// GGX lobes in a cube of 16 texels a side, without parallax: what light estimation on phones gives.
    SmallCube,
}

/// How often light is scattered between the facets of rough surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Facets {
    /// Once, as glTF 2.0 has it: rough metals are darker than they are in nature.
    Single,
    /// Until it leaves: a white metal sends back all light, however rough (Turquin 2019).
    Multiple,
}

/// How lights are chosen and their shadows filtered.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShadowConfig {
    /// Lights at fixed directions over the part of the sphere that light can come from, 1 ..= 112.
    pub dome_lights: u32,
    /// Lights that follow the bright regions, 1 ..= 32.
    pub bright_lights: u32,
    /// Edge of a shadow map in texels, 64 ..= 2048.
    pub map_size: u32,
    /// How shadows are drawn.
    #[serde(deserialize_with = "named")]
    pub method: ShadowMethod,
    /// Whether shadows of real things without phantom are looked for in the picture.
    pub protection: Protection,
}

/// Where virtual objects take no light a second time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Protection {
    /// In the shadows of phantoms alone.
    Off,
    /// In shadows found in the picture as well ([`crate::passes::protect`]); with methods that count the rays of bright
    /// lights, `stable` and `dome-improved`.
    Found,
}

impl Default for ShadowConfig {
    fn default() -> Self {
        Self {
            dome_lights: 48,
            bright_lights: 16,
            map_size: 256,
            method: ShadowMethod::Stable,
            protection: Protection::Found,
        }
    }
}

/// Depth range of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewConfig {
    /// Nearest distance drawn, metres, above 0.
    pub near_m: f32,
    /// Farthest distance drawn, metres, above `near_m`.
    pub far_m: f32,
    /// Where phantoms end before virtual objects.
    pub phantom_edges: PhantomEdges,
}

/// What tells where a real thing before a virtual object ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PhantomEdges {
    /// Its mesh alone.
    Mesh,
    /// The picture, where it shows an edge within two pixels of the mesh's ([`crate::passes::phantom_edge`]).
    Picture,
}

impl Default for ViewConfig {
    fn default() -> Self {
        Self {
            near_m: 0.02,
            far_m: 20.0,
            phantom_edges: PhantomEdges::Picture,
        }
    }
}

/// What is shown, and to how many eyes.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModeConfig {
    /// The mode: `see-through`, `stereo`, `vr`, `vr-stereo`, `optical` or `optical-stereo`.
    #[serde(deserialize_with = "named")]
    pub name: Mode,
    /// Place of the left eye in the scene camera's frame (x right, y down, z forward), metres, each -0.5 ..= 0.5.
    pub left_eye_m: [f64; 3],
    /// Place of the right eye.
    pub right_eye_m: [f64; 3],
    /// Columns and rows of an eye's display, 16 ..= 8192 each; the scene camera's where it is not given.
    pub eye_size_px: Option<[u32; 2]>,
    /// Horizontal field of view of an eye's display, degrees, 10 ..= 150; the scene camera's where it is not given.
    pub field_of_view_deg: Option<f64>,
    /// What stands behind everything in VR.
    pub backdrop: BackdropName,
    /// The colour of `backdrop = "colour"`, linear RGB, 0 ..= 1; 1 is the display's white.
    pub background: [f32; 3],
    /// Whether VR shows the phantoms.
    pub phantoms: PhantomsInVr,
}

/// What stands behind everything in VR.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BackdropName {
    /// One colour.
    Colour,
    /// The light, measured or given.
    Environment,
}

/// Whether VR shows the phantoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PhantomsInVr {
    /// They are not drawn and hide nothing.
    LeftOut,
    /// They are drawn as grey things (albedo 0.5), lit by what reaches them from afar past all objects and from virtual
    /// lamps, so that they show the virtual objects' shadows.
    Grey,
}

impl Default for ModeConfig {
    fn default() -> Self {
        Self {
            name: Mode::SeeThrough,
            // The mean distance between the pupils of adults is 63 mm (Dodgson 2004, "Variation and extrema of human
            // interpupillary distance").
            left_eye_m: [-0.0315, 0.0, 0.0],
            right_eye_m: [0.0315, 0.0, 0.0],
            eye_size_px: None,
            field_of_view_deg: None,
            backdrop: BackdropName::Environment,
            background: [0.0; 3],
            phantoms: PhantomsInVr::LeftOut,
        }
    }
}

impl ModeConfig {
    fn check(&self) -> Result<(), String> {
        for (key, place_m) in [
            ("mode.left_eye_m", self.left_eye_m),
            ("mode.right_eye_m", self.right_eye_m),
        ] {
            for value in place_m {
                within(key, value, -0.5, 0.5)?;
            }
        }
        for edge in self.eye_size_px.into_iter().flatten() {
            within("mode.eye_size_px", f64::from(edge), 16.0, 8192.0)?;
        }
        if let Some(angle_deg) = self.field_of_view_deg {
            within("mode.field_of_view_deg", angle_deg, 10.0, 150.0)?;
        }
        for value in self.background {
            within("mode.background", f64::from(value), 0.0, 1.0)?;
        }
        Ok(())
    }
}

/// What virtual pixels have of the camera beside its lens and its response.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LookConfig {
    /// Blur of virtual objects and their shadows.
    pub sharpness: Sharpness,
    /// Noise of virtual and shaded pixels.
    pub noise: Noise,
}

impl Default for LookConfig {
    fn default() -> Self {
        Self {
            sharpness: Sharpness::Measured,
            noise: Noise::Measured,
        }
    }
}

/// How sharp virtual objects are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sharpness {
    /// As sharp as the edges of the markers in the same picture: out of focus, blurred by motion, soft.
    Measured,
    /// As sharp as pixels allow.
    Off,
}

/// Noise of the pixels that are not the camera's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// Shot noise and read noise by the rig's `full_well_e` and `read_noise_e`.
    Measured,
    /// None.
    Off,
}

impl RenderConfig {
    /// Reads a settings file.
    ///
    /// # Errors
    /// A file that cannot be read, an unknown key, a value out of range; the message names key and range.
    pub fn load(file: &Path) -> Result<Self, RenderError> {
        let text = std::fs::read_to_string(file).map_err(|source| RenderError::Read {
            file: file.to_owned(),
            source,
        })?;
        Self::parse(&text).map_err(|message| RenderError::Config {
            file: file.to_owned(),
            message,
        })
    }

    /// Parses the text of a settings file and checks every range.
    ///
    /// # Errors
    /// One line (or the TOML parser's excerpt) that names the key and what is allowed.
    pub fn parse(text: &str) -> Result<Self, String> {
        let config: Self = toml::from_str(text).map_err(|error| error.to_string())?;
        config.check()?;
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        let Self {
            probe,
            light,
            shadow,
            view,
            mode,
            // Names only; serde has checked them.
            look: LookConfig { sharpness: _, noise: _ },
        } = self;
        mode.check()?;
        within("probe.cube_size", f64::from(probe.cube_size), 32.0, 512.0)?;
        if probe.cube_size % 16 != 0 {
            return Err(format!(
                "`probe.cube_size` is `{}`; it must be a multiple of 16",
                probe.cube_size
            ));
        }
        within("probe.room_distance_m", f64::from(probe.room_distance_m), 0.5, 100.0)?;
        within("probe.camera_radius_m", f64::from(probe.camera_radius_m), 0.0, 0.5)?;
        within("probe.min_view_cosine", f64::from(probe.min_view_cosine), 0.02, 0.9)?;
        within("probe.wrap", f64::from(probe.wrap), 0.0, 1.0)?;
        within("probe.average_frames", f64::from(probe.average_frames), 1.0, 64.0)?;
        within("probe.change_ratio", f64::from(probe.change_ratio), 0.01, 100.0)?;
        within(
            "light.highlight_threshold",
            f64::from(light.highlight_threshold),
            0.0,
            1000.0,
        )?;
        within("shadow.dome_lights", f64::from(shadow.dome_lights), 1.0, 112.0)?;
        within("shadow.bright_lights", f64::from(shadow.bright_lights), 1.0, 32.0)?;
        within("shadow.map_size", f64::from(shadow.map_size), 64.0, 2048.0)?;
        within("view.near_m", f64::from(view.near_m), 1e-3, 10.0)?;
        within("view.far_m", f64::from(view.far_m), f64::from(view.near_m) * 2.0, 1e4)
    }
}

/// A shadow method or a mode by its name.
fn named<'de, D: serde::Deserializer<'de>, T: FromStr<Err = String>>(deserializer: D) -> Result<T, D::Error> {
    let name = String::deserialize(deserializer)?;
    name.parse().map_err(serde::de::Error::custom)
}

fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), String> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(format!("`{key}` is `{value}`; allowed are {low} ..= {high}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_file_gives_the_defaults() {
        assert_eq!(RenderConfig::parse("").unwrap(), RenderConfig::default());
    }

    #[test]
    fn every_method_has_its_name() {
        for method in LightMethod::ALL {
            let config = RenderConfig::parse(&format!("[light]\nextraction = \"{}\"", method.name())).unwrap();
            assert_eq!(config.light.extraction, method);
        }
    }

    #[test]
    fn bad_values_name_the_key_and_the_range() {
        for (text, expected) in [
            (
                "[shadow]\nmethod = \"pcf10\"",
                "`pcf10` is no shadow method; there are none, blob",
            ),
            (
                "[shadow]\nmap_size = 1",
                "`shadow.map_size` is `1`; allowed are 64 ..= 2048",
            ),
            (
                "[probe]\ncube_size = 40",
                "`probe.cube_size` is `40`; it must be a multiple of 16",
            ),
            ("[probe]\nroom_distance_m = nan", "`probe.room_distance_m` is `NaN`"),
            ("[probe]\nroom = 1", "unknown field `room`"),
            ("[probe]\nmapping = \"half\"", "expected `exact` or `simple`"),
            ("[probe]\nwrap = 1.5", "`probe.wrap` is `1.5`; allowed are 0 ..= 1"),
            (
                "[light]\nextraction = \"brightest\"",
                "unknown variant `brightest`, expected one of `stable`, `median_cut`, `regions`",
            ),
            ("[look]\nnoise = \"film\"", "expected `measured` or `off`"),
            ("[look]\nsharpness = \"on\"", "expected `measured` or `off`"),
            (
                "[light]\nspecular = \"blinn\"",
                "expected one of `rays`, `ggx`, `phong`, `highlight`",
            ),
            (
                "[mode]\nname = \"3d\"",
                "`3d` is no mode; there are see-through, stereo, vr,",
            ),
            (
                "[mode]\nleft_eye_m = [-64, 0, 0]",
                "`mode.left_eye_m` is `-64`; allowed are -0.5 ..= 0.5",
            ),
            (
                "[mode]\neye_size_px = [0, 720]",
                "`mode.eye_size_px` is `0`; allowed are 16 ..= 8192",
            ),
            (
                "[mode]\nfield_of_view_deg = 180",
                "`mode.field_of_view_deg` is `180`; allowed are 10 ..= 150",
            ),
            (
                "[mode]\nbackground = [0, 0, 2]",
                "`mode.background` is `2`; allowed are 0 ..= 1",
            ),
            ("[mode]\nphantoms = \"red\"", "expected `left_out` or `grey`"),
            ("[mode]\nbackdrop = \"sky\"", "expected `colour` or `environment`"),
            (
                "[light]\nfacets = \"all\"",
                "unknown variant `all`, expected `single` or `multiple`",
            ),
            (
                "[light]\nhighlight_threshold = -1",
                "`light.highlight_threshold` is `-1`; allowed are 0 ..= 1000",
            ),
        ] {
            let message = RenderConfig::parse(text).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }
}
