//! Maps as pictures: faces in a cross, tone-mapped.

use std::error::Error;
use std::path::Path;

use glam::Vec3;
use mirrorball_calib::probe::cube::{Cube, FACES};
use mirrorball_render::config::{DiffuseMethod, LightConfig, SpecularMethod};
use mirrorball_render::passes::ENVIRONMENT_MIPS;

use crate::rooms;
use crate::stage::Stage;

/// Edge of a face in the picture, pixels.
const FACE_PX: u32 = 128;
/// Column and row of each face.
const PLACES: [[u32; 2]; FACES] = [[2, 1], [0, 1], [1, 0], [1, 2], [1, 1], [3, 1]];

pub(crate) fn write(folder: &Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let mut stage = Stage::new()?;
    for (index, (_, radiance)) in rooms::all().iter().enumerate() {
        stage.upload(radiance);
        for (name, specular) in [
            ("ggx", SpecularMethod::Ggx),
            ("phong", SpecularMethod::Phong),
            ("highlight", SpecularMethod::Highlight),
        ] {
            let maps = stage.maps(&LightConfig {
                specular,
                ..LightConfig::default()
            });
            stage.make(&maps)?;
            for mip in 0..ENVIRONMENT_MIPS {
                save(&stage.specular(mip), &folder.join(format!("{index}_{name}_{mip}.png")))?;
            }
        }
        for (name, diffuse) in [
            ("cosine", DiffuseMethod::CosineCube),
            ("blur", DiffuseMethod::SeparableBlur),
            ("cylindrical", DiffuseMethod::Cylindrical),
        ] {
            let maps = stage.maps(&LightConfig {
                diffuse,
                ..LightConfig::default()
            });
            stage.make(&maps)?;
            save(&stage.irradiance(), &folder.join(format!("{index}_{name}.png")))?;
        }
    }
    Ok(())
}

/// Bilinear between texels, as a shader reads them; the 99th part of the brightest is white.
fn save(cube: &Cube<Vec3>, file: &Path) -> Result<(), Box<dyn Error>> {
    let mut bright: Vec<f32> = cube.texels().iter().map(|t| t.max_element()).collect();
    bright.sort_by(f32::total_cmp);
    let white = bright[bright.len() * 99 / 100].max(1e-6);
    let mut picture = image::RgbImage::new(4 * FACE_PX, 3 * FACE_PX);
    for (face, [column, row]) in PLACES.into_iter().enumerate() {
        for y in 0..FACE_PX {
            for x in 0..FACE_PX {
                let at = |t: u32| (t as f32 + 0.5) / FACE_PX as f32 * 2.0 - 1.0;
                let direction = mirrorball_calib::probe::cube::face_direction(face, at(x), at(y));
                let code = |c: f32| (255.0 * (c / white).clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8;
                let codes = cube.bilinear(direction).to_array().map(code);
                picture.put_pixel(column * FACE_PX + x, row * FACE_PX + y, image::Rgb(codes));
            }
        }
    }
    picture.save(file)?;
    Ok(())
}
