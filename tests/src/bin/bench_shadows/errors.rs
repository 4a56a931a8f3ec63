//! Error of every method against the references: one light from 1024 places over the same ambient light, the direct light
//! of that light and of all directions by paths, and all light by paths.

use crate::{
    gallery::{Gallery, References},
    report::Report,
    stand::Painted,
};
use image::RgbImage;
use mirrorball_render::{error::RenderError, lab::lamp::LampKind, shadow::ShadowMethod};
use mirrorball_tests::{flip::FlipMap, psnr::Psnr};

/// A pixel is in shadow where the reference is darker than the picture without shadows by more than this many codes.
const SHADOW_CODES: u8 = 2;

/// Prints the table.
pub(crate) fn run(
    (gallery, traced): (&Gallery, &References),
    lamp: LampKind,
    report: &mut Report,
) -> Result<(), RenderError> {
    report.table(
        &format!(
            "Error, test scene, {} light and even ambient light: sRGB codes of all surfaces; in brackets where the \
             reference has shadow",
            lamp.name()
        ),
        &[
            "method",
            "area (same ambient): PSNR, dB",
            "FLIP",
            "paths, direct light: PSNR, dB",
            "FLIP",
            "paths, all light: PSNR, dB",
            "FLIP",
        ],
    );
    let found = |wanted| gallery.iter().find(|(method, _)| *method == wanted);
    let picture_of = |wanted| found(wanted).and_then(|(_, painted)| painted.as_ref().ok());
    let unshadowed = picture_of(ShadowMethod::None);
    let references = [
        picture_of(ShadowMethod::Area),
        traced.direct.as_ref().ok(),
        traced.all.as_ref().ok(),
    ];
    for (method, painted) in gallery {
        report.row(&row(*method, painted, (references, unshadowed)));
    }
    for (what, painted) in [("direct light", &traced.direct), ("all light", &traced.all)] {
        if let Err(why) = painted {
            report.say(&format!("\nNo paths of {what}: {why}"));
        }
    }
    Ok(())
}

/// A picture with where there are surfaces.
type Picture = (RgbImage, Vec<bool>);

fn row(
    method: ShadowMethod,
    painted: &Painted,
    (references, unshadowed): ([Option<&Picture>; 3], Option<&Picture>),
) -> Vec<String> {
    let mut cells = vec![method.name().to_owned()];
    let none = || "–".to_owned();
    for (index, reference) in references.into_iter().enumerate() {
        cells.extend(match (painted, reference) {
            (Err(why), _) if index == 0 => [why.clone(), none()],
            (Err(_), _) | (_, None) => [none(), none()],
            (Ok(_), _) if method == ShadowMethod::Area && index == 0 => ["reference".to_owned(), none()],
            (Ok((picture, _)), Some(reference)) => compare(picture, reference, unshadowed),
        });
    }
    cells
}

fn compare(picture: &RgbImage, (reference, surfaces): &Picture, unshadowed: Option<&Picture>) -> [String; 2] {
    let shadow: Vec<bool> = match unshadowed {
        Some((lit, _)) => {
            let is_darker =
                |(lit, dark): (&image::Rgb<u8>, &image::Rgb<u8>)| lit[1] > dark[1].saturating_add(SHADOW_CODES);
            let darker = lit.pixels().zip(reference.pixels()).map(is_darker);
            darker
                .zip(surfaces)
                .map(|(is_darker, is_surface)| is_darker && *is_surface)
                .collect()
        }
        None => vec![false; surfaces.len()],
    };
    let flip = FlipMap::of(picture, reference);
    let both = |whole: Option<String>, inside: Option<String>| match (whole, inside) {
        (Some(whole), Some(inside)) => format!("{whole} ({inside})"),
        (Some(whole), None) => whole,
        (None, _) => "–".to_owned(),
    };
    let psnr = |region: &[bool]| Psnr::of(picture, reference, region).map(|psnr| psnr.to_string());
    let mean = |region: &[bool]| flip.mean(region).map(|mean| format!("{mean:.4}"));
    [both(psnr(surfaces), psnr(&shadow)), both(mean(surfaces), mean(&shadow))]
}
