//! Materials of glTF files, read from their JSON: core and extensions alike.

use serde::Deserialize;

use super::gltf_image::{Images, TextureInfo, one};
use super::material::{Alpha, Clearcoat, Material, Model, NormalMap, Sheen, Sides, Texture, Volume};

/// Extensions that a file may require.
pub(super) const KNOWN_EXTENSIONS: [&str; 10] = [
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_texture_transform",
];

/// The part of a file that this module reads.
#[derive(Debug, Deserialize)]
pub(super) struct MaterialsFile {
    #[serde(default)]
    materials: Vec<Entry>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Entry {
    name: Option<String>,
    pbr_metallic_roughness: MetallicRoughness,
    normal_texture: Option<TextureInfo>,
    occlusion_texture: Option<TextureInfo>,
    emissive_texture: Option<TextureInfo>,
    emissive_factor: [f32; 3],
    alpha_mode: AlphaMode,
    alpha_cutoff: Option<f32>,
    double_sided: bool,
    extensions: Extensions,
    extras: serde_json::Value,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum AlphaMode {
    #[default]
    Opaque,
    Mask,
    Blend,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct MetallicRoughness {
    base_color_factor: [f32; 4],
    base_color_texture: Option<TextureInfo>,
    metallic_factor: f32,
    roughness_factor: f32,
    metallic_roughness_texture: Option<TextureInfo>,
}

impl Default for MetallicRoughness {
    fn default() -> Self {
        Self {
            base_color_factor: [1.0; 4],
            base_color_texture: None,
            metallic_factor: 1.0,
            roughness_factor: 1.0,
            metallic_roughness_texture: None,
        }
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Extensions {
    #[serde(rename = "KHR_materials_clearcoat")]
    clearcoat: Option<ClearcoatEntry>,
    #[serde(rename = "KHR_materials_emissive_strength")]
    emissive_strength: Option<EmissiveStrength>,
    #[serde(rename = "KHR_materials_ior")]
    ior: Option<Ior>,
    #[serde(rename = "KHR_materials_sheen")]
    sheen: Option<SheenEntry>,
    #[serde(rename = "KHR_materials_specular")]
    specular: Option<Specular>,
    #[serde(rename = "KHR_materials_transmission")]
    transmission: Option<Transmission>,
    #[serde(rename = "KHR_materials_unlit")]
    unlit: Option<serde_json::Value>,
    #[serde(rename = "KHR_materials_volume")]
    volume: Option<VolumeEntry>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct ClearcoatEntry {
    clearcoat_factor: f32,
    clearcoat_texture: Option<TextureInfo>,
    clearcoat_roughness_factor: f32,
    clearcoat_roughness_texture: Option<TextureInfo>,
    clearcoat_normal_texture: Option<TextureInfo>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct EmissiveStrength {
    #[serde(default = "one")]
    emissive_strength: f32,
}

#[derive(Debug, Deserialize)]
struct Ior {
    #[serde(default = "usual_ior")]
    ior: f32,
}

fn usual_ior() -> f32 {
    1.5
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct SheenEntry {
    sheen_color_factor: [f32; 3],
    sheen_color_texture: Option<TextureInfo>,
    sheen_roughness_factor: f32,
    sheen_roughness_texture: Option<TextureInfo>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Specular {
    specular_factor: f32,
    specular_texture: Option<TextureInfo>,
    specular_color_factor: [f32; 3],
    specular_color_texture: Option<TextureInfo>,
}

impl Default for Specular {
    fn default() -> Self {
        Self {
            specular_factor: 1.0,
            specular_texture: None,
            specular_color_factor: [1.0; 3],
            specular_color_texture: None,
        }
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Transmission {
    transmission_factor: f32,
    transmission_texture: Option<TextureInfo>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct VolumeEntry {
    thickness_factor: f32,
    thickness_texture: Option<TextureInfo>,
    attenuation_distance: Option<f32>,
    attenuation_color: [f32; 3],
}

impl Default for VolumeEntry {
    fn default() -> Self {
        Self {
            thickness_factor: 0.0,
            thickness_texture: None,
            attenuation_distance: None,
            attenuation_color: [1.0; 3],
        }
    }
}

impl MaterialsFile {
    /// The material `index` of the file, the default one for `None`; a message names the material and what is wrong.
    pub(super) fn material(&self, index: Option<usize>, images: &mut Images<'_>) -> Result<Material, String> {
        let default = Entry::default();
        let Some(index) = index else {
            return default.read(images);
        };
        let entry = self
            .materials
            .get(index)
            .ok_or_else(|| format!("there is no material {index}"))?;
        entry.read(images).map_err(|message| match &entry.name {
            Some(name) => format!("material `{name}`: {message}"),
            None => format!("material {index}: {message}"),
        })
    }
}

impl Entry {
    fn read(&self, images: &mut Images<'_>) -> Result<Material, String> {
        self.check()?;
        let pbr = &self.pbr_metallic_roughness;
        let [r, g, b, a] = pbr.base_color_factor;
        let strength = self
            .extensions
            .emissive_strength
            .as_ref()
            .map_or(1.0, |e| e.emissive_strength);
        let ior = self.extensions.ior.as_ref().map_or(usual_ior(), |i| i.ior);
        let specular = self.extensions.specular.as_ref();
        let (dielectric_f0, dielectric_f90) = dielectric(ior, specular);
        let transmission = self.extensions.transmission.as_ref();
        let mut texture = |info: Option<&TextureInfo>| info.map(|info| images.texture(info)).transpose();
        Ok(Material {
            model: self.model(),
            base_color: [r, g, b],
            opacity: a,
            base_color_texture: texture(pbr.base_color_texture.as_ref())?,
            alpha: self.alpha(),
            sides: if self.double_sided { Sides::Both } else { Sides::Front },
            metallic: pbr.metallic_factor,
            roughness: pbr.roughness_factor,
            metallic_roughness_texture: texture(pbr.metallic_roughness_texture.as_ref())?,
            normal: normal_map(self.normal_texture.as_ref(), &mut texture)?,
            occlusion_texture: texture(self.occlusion_texture.as_ref())?,
            occlusion_strength: self.occlusion_texture.as_ref().map_or(1.0, |info| info.strength),
            emission: self.emissive_factor.map(|e| e * strength),
            emission_texture: texture(self.emissive_texture.as_ref())?,
            dielectric_f0,
            dielectric_f90,
            specular_texture: texture(specular.and_then(|s| s.specular_texture.as_ref()))?,
            specular_color_texture: texture(specular.and_then(|s| s.specular_color_texture.as_ref()))?,
            transmission: transmission.map_or(0.0, |t| t.transmission_factor),
            transmission_texture: texture(transmission.and_then(|t| t.transmission_texture.as_ref()))?,
            ior: ior.max(1.0),
            volume: self.volume(&mut texture)?,
            clearcoat: self.clearcoat(&mut texture)?,
            sheen: self.sheen(&mut texture)?,
        })
    }

    fn model(&self) -> Model {
        if self.extensions.unlit.is_some() {
            Model::Unlit
        } else if self.extras.get("mirrorball_gloss_in_alpha") == Some(&serde_json::Value::Bool(true)) {
            Model::GlossInAlpha
        } else {
            Model::MetallicRoughness
        }
    }

    /// Alpha as gloss says nothing about coverage.
    fn alpha(&self) -> Alpha {
        match (self.model(), &self.alpha_mode) {
            (Model::GlossInAlpha, _) | (_, AlphaMode::Opaque) => Alpha::Opaque,
            (_, AlphaMode::Mask) => Alpha::Mask {
                cutoff: self.alpha_cutoff.unwrap_or(0.5),
            },
            (_, AlphaMode::Blend) => Alpha::Blend,
        }
    }

    fn clearcoat(&self, texture: &mut impl FnMut(Option<&TextureInfo>) -> TextureResult) -> Result<Clearcoat, String> {
        let Some(coat) = &self.extensions.clearcoat else {
            return Ok(Clearcoat::default());
        };
        Ok(Clearcoat {
            factor: coat.clearcoat_factor,
            texture: texture(coat.clearcoat_texture.as_ref())?,
            roughness: coat.clearcoat_roughness_factor,
            roughness_texture: texture(coat.clearcoat_roughness_texture.as_ref())?,
            normal: normal_map(coat.clearcoat_normal_texture.as_ref(), texture)?,
        })
    }

    fn sheen(&self, texture: &mut impl FnMut(Option<&TextureInfo>) -> TextureResult) -> Result<Sheen, String> {
        let Some(sheen) = &self.extensions.sheen else {
            return Ok(Sheen::default());
        };
        Ok(Sheen {
            color: sheen.sheen_color_factor,
            color_texture: texture(sheen.sheen_color_texture.as_ref())?,
            roughness: sheen.sheen_roughness_factor,
            roughness_texture: texture(sheen.sheen_roughness_texture.as_ref())?,
        })
    }

    fn volume(&self, texture: &mut impl FnMut(Option<&TextureInfo>) -> TextureResult) -> Result<Volume, String> {
        let Some(volume) = &self.extensions.volume else {
            return Ok(Volume::default());
        };
        Ok(Volume {
            thickness_m: volume.thickness_factor,
            thickness_texture: texture(volume.thickness_texture.as_ref())?,
            attenuation_distance_m: volume.attenuation_distance.unwrap_or(f32::INFINITY),
            attenuation_color: volume.attenuation_color,
        })
    }

    /// Ranges of the factors, as the specification and the extensions give them.
    fn check(&self) -> Result<(), String> {
        let pbr = &self.pbr_metallic_roughness;
        shares("baseColorFactor", &pbr.base_color_factor)?;
        shares("metallicFactor", &[pbr.metallic_factor])?;
        shares("roughnessFactor", &[pbr.roughness_factor])?;
        shares("emissiveFactor", &self.emissive_factor)?;
        positive("alphaCutoff", self.alpha_cutoff.unwrap_or(0.5))?;
        if let Some(occlusion) = &self.occlusion_texture {
            shares("occlusionTexture.strength", &[occlusion.strength])?;
        }
        let extensions = &self.extensions;
        if let Some(emissive) = &extensions.emissive_strength {
            positive("emissiveStrength", emissive.emissive_strength)?;
        }
        if let Some(Ior { ior }) = extensions.ior
            && !(ior == 0.0 || (1.0..1e3).contains(&ior))
        {
            return Err(format!(
                "an index of refraction of {ior}; it is 0, for a surface that reflects everything, or 1 or more"
            ));
        }
        if let Some(specular) = &extensions.specular {
            shares("specularFactor", &[specular.specular_factor])?;
            for &factor in &specular.specular_color_factor {
                positive("specularColorFactor", factor)?;
            }
        }
        if let Some(transmission) = &extensions.transmission {
            shares("transmissionFactor", &[transmission.transmission_factor])?;
        }
        if let Some(volume) = &extensions.volume {
            positive("thicknessFactor", volume.thickness_factor)?;
            shares("attenuationColor", &volume.attenuation_color)?;
            if volume.attenuation_distance.is_some_and(|d| d.is_nan() || d <= 0.0) {
                return Err("`attenuationDistance` must be more than 0".into());
            }
        }
        self.check_layers()
    }

    fn check_layers(&self) -> Result<(), String> {
        if let Some(coat) = &self.extensions.clearcoat {
            shares("clearcoatFactor", &[coat.clearcoat_factor])?;
            shares("clearcoatRoughnessFactor", &[coat.clearcoat_roughness_factor])?;
        }
        if let Some(sheen) = &self.extensions.sheen {
            shares("sheenColorFactor", &sheen.sheen_color_factor)?;
            shares("sheenRoughnessFactor", &[sheen.sheen_roughness_factor])?;
        }
        Ok(())
    }
}

type TextureResult = Result<Option<Texture>, String>;

/// Reflectance at normal and at grazing incidence (KHR_materials_ior, KHR_materials_specular).
fn dielectric(ior: f32, specular: Option<&Specular>) -> ([f32; 3], f32) {
    // An index of 0 stands for a surface that reflects everything: (0 - 1)² / (0 + 1)² is 1.
    let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
    specular.map_or(([f0; 3], 1.0), |specular| {
        let factor = specular.specular_factor;
        (
            specular.specular_color_factor.map(|c| (f0 * c).min(1.0) * factor),
            factor,
        )
    })
}

fn normal_map(
    info: Option<&TextureInfo>,
    texture: &mut impl FnMut(Option<&TextureInfo>) -> TextureResult,
) -> Result<Option<NormalMap>, String> {
    let scale = info.map_or(1.0, |info| info.scale);
    if !scale.is_finite() {
        return Err(format!("a normal texture has the scale {scale}"));
    }
    Ok(texture(info)?.map(|texture| NormalMap { texture, scale }))
}

fn shares(name: &str, values: &[f32]) -> Result<(), String> {
    match values.iter().find(|value| !(0.0..=1.0).contains(*value)) {
        Some(bad) => Err(format!("`{name}` holds `{bad}`; allowed are 0 ..= 1")),
        None => Ok(()),
    }
}

fn positive(name: &str, value: f32) -> Result<(), String> {
    if (0.0..f32::INFINITY).contains(&value) {
        return Ok(());
    }
    Err(format!("`{name}` is `{value}`; it must be a finite number, 0 or more"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(json: &str) -> Entry {
        serde_json::from_str(json).unwrap()
    }

    #[test]
    fn an_empty_material_is_that_of_the_specification() {
        let pbr = entry("{}").pbr_metallic_roughness;
        assert_eq!(
            (pbr.base_color_factor, pbr.metallic_factor, pbr.roughness_factor),
            ([1.0; 4], 1.0, 1.0)
        );
        assert_eq!(entry("{}").alpha(), Alpha::Opaque);
        assert_eq!(entry(r#"{"alphaMode": "MASK"}"#).alpha(), Alpha::Mask { cutoff: 0.5 });
        let ([f0, ..], f90) = dielectric(1.5, None);
        assert!((f0 - 0.04).abs() < 1e-7 && f90 == 1.0, "{f0} {f90}");
    }

    #[test]
    fn extras_and_extensions_choose_the_model() {
        let gloss = entry(r#"{"alphaMode": "BLEND", "extras": {"mirrorball_gloss_in_alpha": true}}"#);
        assert_eq!((gloss.model(), gloss.alpha()), (Model::GlossInAlpha, Alpha::Opaque));
        assert_eq!(entry(r#"{"extras": 3}"#).model(), Model::MetallicRoughness);
        assert_eq!(
            entry(r#"{"extensions": {"KHR_materials_unlit": {}}}"#).model(),
            Model::Unlit
        );
    }

    #[test]
    fn bad_factors_are_named_with_what_is_allowed() {
        for (json, expected) in [
            (
                r#"{"pbrMetallicRoughness": {"metallicFactor": 2}}"#,
                "`metallicFactor` holds `2`; allowed are 0 ..= 1",
            ),
            (
                r#"{"extensions": {"KHR_materials_ior": {"ior": 0.5}}}"#,
                "index of refraction of 0.5",
            ),
            (
                r#"{"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": -1}}}"#,
                "`clearcoatFactor` holds `-1`",
            ),
            (
                r#"{"extensions": {"KHR_materials_volume": {"attenuationDistance": 0}}}"#,
                "`attenuationDistance`",
            ),
            (
                r#"{"extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": -3}}}"#,
                "`emissiveStrength` is `-3`",
            ),
        ] {
            let message = entry(json).check().unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }
}
