//! The test scene drawn with every method.

use crate::{
    report::Report,
    stand::{Effort, Painted, Stand, Way},
};
use image::{Rgb, RgbImage};
use mirrorball_render::{
    error::RenderError,
    lab::{lamp::LampKind, scenes::MovingScene},
    shadow::ShadowMethod,
};
use mirrorball_tests::sheet::{self, Row};

/// Pictures in a row of the sheet.
const COLUMNS: usize = 4;

/// All methods with their pictures.
pub(crate) type Gallery = Vec<(ShadowMethod, Painted)>;

/// Draws all pictures under a lamp.
pub(crate) fn paint(effort: &Effort, lamp: LampKind) -> Result<Gallery, RenderError> {
    let mut stand = Stand::new(MovingScene::test(0), effort.picture_px([640, 480]))?.with_lamp(lamp);
    let mut gallery = Gallery::new();
    for method in ShadowMethod::ALL {
        gallery.push((method, stand.paint(Way::new(method, effort.map_size(2048)))?));
    }
    Ok(gallery)
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
                    (method.name(), picture)
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
