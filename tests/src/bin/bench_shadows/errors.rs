//! Error of every method against the two references: one light from 1024 places over the same ambient light, and paths.

use crate::{gallery::Gallery, report::Report};
use image::RgbImage;
use mirrorball_render::{error::RenderError, lab::lamp::LampKind, shadow::ShadowMethod};
use mirrorball_tests::{flip::FlipMap, psnr::Psnr};

/// A pixel is in shadow where the reference is darker than the picture without shadows by more than this many codes.
const SHADOW_CODES: u8 = 2;

/// Prints the table.
pub(crate) fn run(gallery: &Gallery, lamp: LampKind, report: &mut Report) -> Result<(), RenderError> {
    report.table(
        &format!(
            "Error, test scene, {} light and even ambient light: sRGB codes of all surfaces; in brackets where the \
             reference has shadow",
            lamp.name()
        ),
        &["method", "area: PSNR, dB", "area: FLIP", "path: PSNR, dB", "path: FLIP"],
    );
    let unshadowed = found(gallery, ShadowMethod::None);
    let references = [ShadowMethod::Area, ShadowMethod::PathTraced].map(|method| (method, found(gallery, method)));
    for (method, painted) in gallery {
        let mut cells = vec![method.name().to_owned()];
        match painted {
            Ok((picture, _)) => {
                for (reference_method, reference) in references {
                    cells.extend(match reference {
                        _ if *method == reference_method => ["reference".to_owned(), "–".to_owned()],
                        None => ["no reference".to_owned(), "–".to_owned()],
                        Some(reference) => compare(picture, reference, unshadowed),
                    });
                }
            }
            Err(why) => cells.extend([why.clone(), "–".to_owned(), "–".to_owned(), "–".to_owned()]),
        }
        report.row(&cells);
    }
    Ok(())
}

fn found(gallery: &Gallery, wanted: ShadowMethod) -> Option<&(RgbImage, Vec<bool>)> {
    let (_, painted) = gallery.iter().find(|(method, _)| *method == wanted)?;
    painted.as_ref().ok()
}

fn compare(
    picture: &RgbImage,
    (reference, surfaces): &(RgbImage, Vec<bool>),
    unshadowed: Option<&(RgbImage, Vec<bool>)>,
) -> [String; 2] {
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
