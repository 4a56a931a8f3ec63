//! `markers`: where the markers are to each other.

use std::{collections::BTreeMap, io::Write, path::PathBuf};

use mirrorball_calib::{
    extrinsics::{
        BundleError,
        markers::{FieldError, FieldInput, FieldMarker, MarkerField, solve},
    },
    report::{Block, Report},
    rig::{Marker, RigParts},
    tag::Family,
};
use serde::Serialize;

use super::{
    CommandError,
    explain::Explain,
    input::InputArgs,
    output::OutputArgs,
    progress::Progress,
    sightings::{RigText, SightingsError},
    view_list::{
        RejectedEntry, Rows, SigmaEntry, ViewEntry, difference, matrix_rows, push_views, rejected_entries, rows,
        view_entries,
    },
};

/// Reflectance of paper that nobody has measured; as for markers in rig files.
const WHITE_REFLECTANCE: f64 = 0.8;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Rig file with the camera's lens; markers that it has already are found anew and compared.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Camera of the rig that took the pictures.
    #[arg(long, value_name = "NAME")]
    camera: String,
    /// Id of the marker that is the world; the rig's main marker unless given.
    #[arg(long, value_name = "ID")]
    main: Option<u32>,
    /// Side of the black square of markers that neither `--side` nor the rig file gives one, in metres.
    #[arg(long, value_name = "METRES", value_parser = side)]
    side_m: Option<f64>,
    /// Side of one marker's black square in metres.
    #[arg(long, value_name = "ID=METRES", value_parser = id_and_side)]
    side: Vec<(u32, f64)>,
    #[command(flatten)]
    output: OutputArgs,
}

fn side(text: &str) -> Result<f64, String> {
    let metres = text.parse::<f64>().ok().filter(|side| *side > 0.0 && side.is_finite());
    metres.ok_or_else(|| "a length in metres above 0".to_owned())
}

fn id_and_side(text: &str) -> Result<(u32, f64), String> {
    let form = || "a marker's id and its side in metres, as in `4=0.05`".to_owned();
    let (id, metres) = text.split_once('=').ok_or_else(form)?;
    Ok((id.parse().map_err(|_| form())?, side(metres)?))
}

/// Why there is no field of markers.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MarkersError {
    #[error("neither `--main` nor the rig file says which marker is the world")]
    NoMain,
    #[error("the markers cannot be placed")]
    Field(#[from] FieldError),
}

impl Explain for MarkersError {
    fn is_bad_input(&self) -> bool {
        // Sides and pictures that contradict each other are bad input; a solve that does not end is not.
        !matches!(self, Self::Field(FieldError::Bundle(BundleError::Solve(_))))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::NoMain => "name it with `--main`",
            Self::Field(FieldError::NoMainSide { .. }) => "give it with `--side-m` or `--side`",
            Self::Field(FieldError::MainUnseen { .. }) => {
                "take pictures that show it, or choose another one with `--main`"
            }
            Self::Field(FieldError::TooFewViews { .. }) => {
                "take pictures from many sides, each with several markers, some with the main one"
            }
            Self::Field(FieldError::Bundle(_)) => {
                "look whether a marker moved between pictures, is there twice, or has another side than given"
            }
        })
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output.check()?;
    let rig = RigText::read(&args.rig)?;
    let camera = rig.camera(&args.camera)?;
    let main_marker = args.main.or(rig.parts.main_marker).ok_or(MarkersError::NoMain)?;
    let seen = rig.look(
        args.input.open().map_err(SightingsError::from)?,
        std::slice::from_ref(&camera),
    )?;
    let views: Vec<_> = seen.into_iter().map(|seen| seen.view).collect();
    let ids = views
        .iter()
        .flat_map(|view| view.detections.iter().map(|detection| detection.id));
    let sides_m: BTreeMap<u32, f64> = ids
        .filter_map(|id| Some((id, side_of(id, args, &rig.parts)?)))
        .collect();
    let input = FieldInput {
        intrinsics: &camera.intrinsics,
        views: &views,
        sides_m: &sides_m,
        main_marker,
    };
    let field = {
        let _progress = Progress::solve("placing the markers");
        solve(&input).map_err(MarkersError::from)?
    };
    write_text(&field, &rig.parts, out).map_err(CommandError::Output)?;
    let mut draft = rig.draft(&args.output)?;
    draft.set_main_marker(main_marker);
    for marker in &field.markers {
        draft.set_marker(&entry(marker, &rig.parts));
    }
    args.output.write_json(&Numbers::of(&field, main_marker, &rig.parts))?;
    args.output.write_report(|| report(&field, main_marker, &rig.parts))?;
    Ok(args.output.write_rig(&draft)?)
}

fn side_of(id: u32, args: &Args, rig: &RigParts) -> Option<f64> {
    let given = args.side.iter().find(|side| side.0 == id).map(|side| side.1);
    given.or_else(|| Some(old(id, rig)?.side_m)).or(args.side_m)
}

/// The marker as the rig file has it.
fn old(id: u32, rig: &RigParts) -> Option<&Marker> {
    rig.markers.iter().find(|marker| marker.id == id)
}

fn entry(marker: &FieldMarker, rig: &RigParts) -> Marker {
    let old = old(marker.id, rig);
    Marker {
        family: old.map_or(Family::Tag36h11, |old| old.family),
        id: marker.id,
        side_m: marker.side_m,
        white_reflectance: old.map_or(WHITE_REFLECTANCE, |old| old.white_reflectance),
        world_from_marker: marker.world_from_marker,
    }
}

/// How far a marker is from where the rig file has it.
fn change(marker: &FieldMarker, rig: &RigParts) -> Option<SigmaEntry> {
    Some(difference(
        &marker.world_from_marker,
        &old(marker.id, rig)?.world_from_marker,
    ))
}

/// What the JSON file holds; its keys are an interface.
#[derive(Serialize)]
struct Numbers<'a> {
    routine: &'static str,
    main_marker: u32,
    rms_px: f64,
    markers: Vec<MarkerEntry>,
    unconnected: &'a [u32],
    without_side: &'a [u32],
    views: Vec<ViewEntry<'a>>,
    rejected: Vec<RejectedEntry<'a>>,
}

#[derive(Serialize)]
struct MarkerEntry {
    id: u32,
    side_m: f64,
    world_from_marker: Rows,
    sigma: SigmaEntry,
    covariance: Vec<Vec<f64>>,
    views: usize,
    change: Option<SigmaEntry>,
}

impl<'a> Numbers<'a> {
    fn of(field: &'a MarkerField, main_marker: u32, rig: &RigParts) -> Self {
        let entry = |marker: &FieldMarker| MarkerEntry {
            id: marker.id,
            side_m: marker.side_m,
            world_from_marker: rows(&marker.world_from_marker),
            sigma: marker.sigma.into(),
            covariance: matrix_rows(&marker.covariance),
            views: marker.views,
            change: change(marker, rig),
        };
        Self {
            routine: "markers",
            main_marker,
            rms_px: field.rms_px,
            markers: field.markers.iter().map(entry).collect(),
            unconnected: &field.unconnected,
            without_side: &field.without_side,
            views: view_entries(&field.views),
            rejected: rejected_entries(&field.rejected),
        }
    }
}

/// Cells of the table of markers.
fn cells(marker: &FieldMarker, rig: &RigParts) -> Vec<String> {
    let (sigma, place) = (
        SigmaEntry::from(marker.sigma),
        1e3 * marker.world_from_marker.translation,
    );
    let changed = change(marker, rig);
    let changed = changed.map(|c| format!("{:.3} mm, {:.3}°", c.place_mm, c.rotation_deg));
    vec![
        marker.id.to_string(),
        marker.views.to_string(),
        format!("{:.2} {:.2} {:.2}", place.x, place.y, place.z),
        format!("{:.3}", sigma.place_mm),
        format!("{:.3}", sigma.rotation_deg),
        changed.unwrap_or_else(|| "new".to_owned()),
    ]
}

const HEAD: [&str; 6] = ["marker", "pictures", "place, mm", "σ mm", "σ °", "change"];

/// What should not be so.
fn warnings(field: &MarkerField) -> Vec<String> {
    let list = |ids: &[u32]| ids.iter().map(|id| format!("`{id}`")).collect::<Vec<_>>().join(", ");
    let mut warnings = Vec::new();
    if !field.unconnected.is_empty() {
        warnings.push(format!(
            "never seen beside markers that lead to the main one, and left out: {}; take pictures that show them together",
            list(&field.unconnected)
        ));
    }
    if !field.without_side.is_empty() {
        warnings.push(format!(
            "side not known, and left out: {}; give it with `--side ID=METRES`",
            list(&field.without_side)
        ));
    }
    warnings
}

fn write_text(field: &MarkerField, rig: &RigParts, out: &mut impl Write) -> std::io::Result<()> {
    let mut line = |cells: &[String]| {
        let [id, views, place, mm, deg, change] = cells else {
            return Ok(());
        };
        writeln!(out, "{id:>6}  {views:>8}  {place:>24}  {mm:>7}  {deg:>7}  {change}")
    };
    line(&HEAD.map(str::to_owned))?;
    for marker in &field.markers {
        line(&cells(marker, rig))?;
    }
    let (views, rejected) = (field.views.len(), field.rejected.len());
    writeln!(
        out,
        "{views} pictures, {:.3} px root mean square, {rejected} detections left out",
        field.rms_px
    )?;
    for warning in warnings(field) {
        writeln!(out, "warning: {warning}")?;
    }
    Ok(())
}

fn report(field: &MarkerField, main_marker: u32, rig: &RigParts) -> Report {
    let mut report = Report::new("Markers");
    report.push(Block::Text(format!(
        "{} markers in the frame of marker {main_marker}, from {} pictures; root mean square error {:.3} px.",
        field.markers.len(),
        field.views.len(),
        field.rms_px
    )));
    for warning in warnings(field) {
        report.push(Block::Warning(warning));
    }
    report.push(Block::Table {
        caption:
            "Places of the markers' centres in the world; σ along the worst direction and about the worst axis; change \
                  against the rig file"
                .to_owned(),
        head: HEAD.map(str::to_owned).to_vec(),
        rows: field.markers.iter().map(|marker| cells(marker, rig)).collect(),
    });
    push_views(&mut report, &field.views, &field.rejected);
    report
}
