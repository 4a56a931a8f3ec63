//! The test scene drawn with every method.

use crate::{
    report::Report,
    stand::{Effort, Painted, Stand, Way},
};
use image::{Rgb, RgbImage};
use mirrorball_render::{
    error::RenderError,
    lab::{lamp::LampKind, scenes::MovingScene},
    shadow::{ShadowMethod, path::PathSettings},
};
use mirrorball_tests::sheet::{self, Row};

/// Pictures in a row of the sheet.
const COLUMNS: usize = 4;

/// All methods with their pictures.
pub(crate) type Gallery = Vec<(ShadowMethod, Painted)>;

/// What the pictures are measured against, besides the area light's.
pub(crate) struct References {
    /// Direct light by paths: what the methods approximate.
    pub(crate) direct: Painted,
    /// All light by paths.
    pub(crate) all: Painted,
}

/// Makes the stand for all pictures under a lamp.
pub(crate) fn stand(effort: &Effort, lamp: LampKind) -> Result<Stand, RenderError> {
    Ok(Stand::new(MovingScene::test(0), effort.picture_px([640, 480]))?.with_lamp(lamp))
}

/// Draws all pictures.
pub(crate) fn paint(effort: &Effort, stand: &mut Stand) -> Result<Gallery, RenderError> {
    let mut gallery = Gallery::new();
    for method in ShadowMethod::ALL {
        gallery.push((method, stand.paint(Way::new(method, effort.map_size(2048)))?));
    }
    Ok(gallery)
}

/// Traces the references.
pub(crate) fn references(effort: &Effort, stand: &mut Stand) -> Result<References, RenderError> {
    let direct = PathSettings::direct(effort.paths());
    let all = PathSettings {
        max_bounces: PathSettings::default().max_bounces,
        ..direct
    };
    Ok(References {
        direct: stand.trace(&direct)?,
        all: stand.trace(&all)?,
    })
}

/// Writes the contact sheet. A method that refuses has a dark picture.
pub(crate) fn sheet(gallery: &Gallery, report: &mut Report) -> Result<(), RenderError> {
    let size_px = gallery
        .iter()
        .find_map(|(_, painted)| painted.as_ref().ok())
        .map_or((640, 480), |(picture, _)| picture.dimensions());
    let dark = || RgbImage::from_pixel(size_px.0, size_px.1, Rgb([40, 40, 44]));
    let rows: Vec<Row> = gallery
        .chunks(COLUMNS)
        .map(|methods| Row {
            title: String::new(),
            pictures: methods
                .iter()
                .map(|(method, painted)| {
                    let picture = painted.as_ref().map_or_else(|_| dark(), |(picture, _)| picture.clone());
                    (method.name().to_owned(), picture)
                })
                .collect(),
        })
        .collect();
    report.say("\n### Contact sheet");
    for (method, painted) in gallery {
        if let Err(why) = painted {
            report.say(&format!("\n`{}` is missing: {why}", method.name()));
        }
    }
    report.picture("methods.png", &sheet::draw(&rows))
}
