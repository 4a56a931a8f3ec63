//! The sheet of patches as a drawing to print.

use std::fmt::Write as _;

use glam::DVec2;

use super::patches::PatchSheet;
use crate::tag::{Family, Layout};

/// Width and height of the page, A4 upright, in millimetres.
const PAGE_MM: DVec2 = DVec2::new(210.0, 297.0);

/// Family of the sheet's marker.
pub const MARKER_FAMILY: Family = Family::Tag36h11;

/// The ruler below the patches: where it begins on the page, and its length.
const RULER_MM: (DVec2, u32) = (DVec2::new(55.0, 278.0), 100);

/// Draws a sheet as SVG in millimetres on A4: its marker, its patches, a ruler of 100 mm to see whether the printer kept the size.
///
/// `None` when the sheet has no marker of its own with a side, or the family no such id.
#[must_use]
pub fn sheet_svg(sheet: &PatchSheet) -> Option<String> {
    let (id, side_m) = (sheet.marker?, sheet.marker_side_m?);
    let code = MARKER_FAMILY.code(id)?;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\" \
         font-family=\"sans-serif\" font-size=\"3\">\n<rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>\n",
        w = PAGE_MM.x,
        h = PAGE_MM.y
    );
    for patch in &sheet.patches {
        let low = page_mm(patch.center_m + 0.5 * patch.side_m * DVec2::new(-1.0, 1.0));
        let side = 1e3 * patch.side_m;
        if let Some([r, g, b]) = patch.print {
            rect(&mut svg, low, side, &format!("#{r:02x}{g:02x}{b:02x}"));
        }
        let at = low + DVec2::new(0.0, side + 3.2);
        text(&mut svg, at, &patch.name);
    }
    let layout = Layout::new(MARKER_FAMILY, 1);
    let cell_mm = 1e3 * side_m / layout.quad_cells() as f64;
    let corner = page_mm(0.5 * side_m * DVec2::new(-1.0, 1.0));
    rect(&mut svg, corner, 1e3 * side_m, "#000000");
    let (first, end) = (layout.margin_cells(), layout.margin_cells() + layout.quad_cells());
    for (y, row) in layout.picture(code)[first..end].iter().enumerate() {
        for (x, _) in row[first..end].iter().enumerate().filter(|(_, is_white)| **is_white) {
            let place = DVec2::new(x as f64, y as f64);
            rect(&mut svg, corner + cell_mm * place, cell_mm, "#ffffff");
        }
    }
    ruler(&mut svg);
    let title = format!(
        "Print at 100 %, matt paper. Marker {id} of {MARKER_FAMILY}, {:.1} mm.",
        1e3 * side_m
    );
    text(&mut svg, DVec2::new(RULER_MM.0.x, RULER_MM.0.y + 9.0), &title);
    svg.push_str("</svg>\n");
    Some(svg)
}

/// Place on the page, from the top left in millimetres, of a point of the sheet: the marker is in the middle.
fn page_mm(point_m: DVec2) -> DVec2 {
    0.5 * PAGE_MM + 1e3 * DVec2::new(point_m.x, -point_m.y)
}

fn rect(svg: &mut String, corner: DVec2, side: f64, fill: &str) {
    let DVec2 { x, y } = corner;
    let _ = writeln!(
        svg,
        "<rect x=\"{x:.3}\" y=\"{y:.3}\" width=\"{side:.3}\" height=\"{side:.3}\" fill=\"{fill}\" shape-rendering=\"crispEdges\"/>"
    );
}

fn text(svg: &mut String, at: DVec2, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    let _ = writeln!(svg, "<text x=\"{:.3}\" y=\"{:.3}\">{text}</text>", at.x, at.y);
}

/// A line with a mark each 10 mm.
fn ruler(svg: &mut String) {
    let (DVec2 { x, y }, length) = RULER_MM;
    let mut path = format!("M{x} {y}h{length}");
    for mark in (0..=length).step_by(10) {
        let _ = write!(path, "M{} {y}v-3", x + f64::from(mark));
    }
    let _ = writeln!(
        svg,
        "<path d=\"{path}\" stroke=\"#000000\" stroke-width=\"0.2\" fill=\"none\"/>"
    );
    text(svg, DVec2::new(x + f64::from(length) + 2.0, y), &format!("{length} mm"));
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use mirrorball_capture::frame::Exposure;

    use super::*;
    use crate::{
        camera::{Intrinsics, LensModel},
        color::sample::{PatchPicture, SheetPlacing, sample},
        photometry::Photometry,
        response::ResponseCurve,
        tag::{Detector, LumaView},
    };

    /// Pixels per millimetre.
    const SCALE: f64 = 3.0;
    const SIZE: [u32; 2] = [630, 891];
    /// Light of white paper.
    const PAPER: f64 = 0.8;

    fn hex(fill: &str) -> [u8; 3] {
        [1, 3, 5].map(|at| u8::from_str_radix(&fill[at..at + 2], 16).unwrap())
    }

    /// The picture that a camera straight above takes of the print.
    fn photograph(svg: &str, response: &ResponseCurve) -> Vec<u8> {
        let page = roxmltree::Document::parse(svg).unwrap();
        let mut codes = vec![0; 3 * (SIZE[0] * SIZE[1]) as usize];
        for node in page
            .descendants()
            .filter(|node| node.has_tag_name(("http://www.w3.org/2000/svg", "rect")))
        {
            let number = |name: &str| node.attribute(name).map_or(0.0, |text| text.parse().unwrap());
            let [x, y, width, height] = ["x", "y", "width", "height"].map(|name| SCALE * number(name));
            let color = hex(node.attribute("fill").unwrap())
                .map(|code| response.encode(PAPER * response.linear_from_code(code)));
            for row in y.round() as u32..(y + height).round() as u32 {
                for column in x.round() as u32..(x + width).round() as u32 {
                    let at = 3 * (row * SIZE[0] + column) as usize;
                    codes[at..at + 3].copy_from_slice(&color);
                }
            }
        }
        codes
    }

    #[test]
    fn a_photograph_of_the_print_gives_back_the_patches() {
        let sheet = PatchSheet::printed();
        let response = ResponseCurve::srgb();
        let codes = photograph(&sheet_svg(&sheet).unwrap(), &response);
        let luma: Vec<u8> = codes.chunks_exact(3).map(|rgb| rgb[1]).collect();
        let [width, height] = SIZE.map(|size| size as usize);
        let view = LumaView::new([width, height], width, &luma).unwrap();
        let found = Detector::new(&[MARKER_FAMILY]).detect(view);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(Some(found[0].id), sheet.marker);
        let intrinsics = Intrinsics {
            size_px: SIZE,
            focal_px: DVec2::splat(900.0),
            principal_point_px: DVec2::new(314.5, 445.0),
            lens: LensModel::BrownConrady {
                k1: 0.0,
                k2: 0.0,
                p1: 0.0,
                p2: 0.0,
                k3: 0.0,
            },
        };
        let photometry = Photometry {
            sensitivity: 1.0,
            vignetting: [0.0; 2],
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
            response: response.clone(),
            color: DMat3::IDENTITY,
        };
        let exposure = Exposure {
            time_s: 1.0,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let picture = PatchPicture {
            codes: &codes,
            intrinsics: &intrinsics,
            photometry: &photometry,
            exposure: &exposure,
        };
        let corners = sheet.marker_corners_m().unwrap();
        let placing = SheetPlacing::from_corners(&corners, &found[0].corners_px, &intrinsics).unwrap();
        for patch in &sheet.patches {
            let light = sample(&picture, patch, &placing).unwrap();
            let expected = patch
                .print
                .unwrap_or([255; 3])
                .map(|code| PAPER * response.linear_from_code(code));
            for (found, expected) in light.radiance.into_iter().zip(expected) {
                assert!(
                    (found / expected - 1.0).abs() < 0.02,
                    "{} {found} {expected}",
                    patch.name
                );
            }
            // Read is the share of 0.6 of a patch of 90 pixels, whole: nothing beside it.
            assert!(
                (light.pixels as f64 / 54f64.powi(2) - 1.0).abs() < 0.05,
                "{}",
                light.pixels
            );
        }
        assert!(sheet.patches.iter().filter(|patch| patch.is_neutral).count() >= 8);
    }

    #[test]
    fn the_page_holds_the_sheet_and_sheets_without_marker_are_not_drawn() {
        let mut sheet = PatchSheet::printed();
        for patch in &sheet.patches {
            for sign in [-1.0, 1.0] {
                let corner = page_mm(patch.center_m + 0.5 * patch.side_m * sign);
                assert!(
                    corner.min_element() > 10.0 && (PAGE_MM - corner).min_element() > 10.0,
                    "{}",
                    patch.name
                );
            }
            // The marker keeps a white edge of one cell.
            let gap = patch.center_m.abs().max_element() - 0.5 * (patch.side_m + 0.064);
            assert!(gap > 0.008, "{} {gap}", patch.name);
        }
        sheet.marker = Some(587);
        assert_eq!(sheet_svg(&sheet), None);
        assert_eq!(sheet_svg(&PatchSheet::color_checker()), None);
    }
}
