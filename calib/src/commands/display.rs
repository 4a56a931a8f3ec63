//! `display`: eye and display of a see-through headset, from points that a person aligned with crosses.

use std::{
    fs, io,
    io::Write,
    path::{Path, PathBuf},
};

use glam::{DVec2, DVec3};
use image::RgbImage;
use mirrorball_calib::{
    extrinsics::{
        cameras::{CameraError, fixed},
        display::{Alignment, DisplayError, EyeDisplay, solve},
    },
    report::{
        Block, Plot, Report,
        plot::{Axis, Series, Style},
    },
};
use serde::Serialize;

use super::{
    CommandError,
    csv::{Table, TableError},
    explain::Explain,
    input::Pictures,
    output::OutputArgs,
    probe::canvas,
    progress::Progress,
    sightings::RigText,
    view_list::{Rows, SigmaEntry, matrix_rows, rows},
};

/// Distances of the point from the eye that prompts ask for, metres.
const DISTANCES_M: [f64; 3] = [0.5, 1.0, 2.0];

/// Part of the display, in each direction, in which crosses stand.
const INNER: f64 = 0.8;

/// Half the length of a cross's lines in pixels.
const CROSS_PX: i64 = 24;

/// Enlargement of residuals in the report.
const RESIDUAL_SCALE: f64 = 10.0;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the pictures to show on the display, one after the other, and `prompts.csv` (number, u, v, distance_m).
    #[arg(long, value_name = "DIR", requires = "size_px", conflicts_with = "alignments")]
    prompts: Option<PathBuf>,
    /// Columns and rows of the display.
    #[arg(long, value_name = "W,H", value_parser = size)]
    size_px: Option<[u32; 2]>,
    /// Number of prompts.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(8..=500))]
    points: u32,
    /// What was aligned: CSV with `number,u,v,x,y,z`, the point in the frame of the headset's camera in metres; or with
    /// `number,u,v,sequence`, the frame of the recording in which the marker shows where the point was.
    #[arg(long, value_name = "FILE.csv", required_unless_present = "prompts")]
    alignments: Option<PathBuf>,
    /// Recording with those frames.
    #[arg(long, value_name = "PATH", requires_all = ["rig", "camera", "marker"])]
    recording: Option<PathBuf>,
    /// Rig file with the camera's lens and the markers' places.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Camera on the headset.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Marker whose centre was aligned.
    #[arg(long, value_name = "ID")]
    marker: Option<u32>,
    /// File for the numbers.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// File for a page with plots.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let number = |text: &str| text.parse().ok().filter(|n| (100..=16384).contains(n));
    let numbers = text
        .split_once(',')
        .map(|(width, height)| (number(width), number(height)));
    let Some((Some(width), Some(height))) = numbers else {
        return Err("columns and rows of 100 to 16384, as in `1280,720`".to_owned());
    };
    Ok([width, height])
}

/// Why there is no eye.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DisplayFailure {
    #[error("cannot write `{}`", file.display())]
    Write {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("`{}` names frames, but there is no `--recording`", file.display())]
    NoRecording { file: PathBuf },
    #[error("marker `{id}` is not in the rig file")]
    NoMarker { id: u32 },
    #[error("the recording has no frame `{sequence}` of camera `{camera}` (alignment `{number}`)")]
    NoFrame { number: u32, sequence: u64, camera: String },
    #[error("frame `{sequence}` does not show where the camera was (alignment `{number}`)")]
    Frame {
        number: u32,
        sequence: u64,
        #[source]
        source: CameraError,
    },
    #[error("eye and display cannot be found")]
    Solve(#[from] DisplayError),
}

impl Explain for DisplayFailure {
    fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Write { .. } | Self::Solve(DisplayError::Solve(_)))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::Write { .. } => return None,
            Self::NoRecording { .. } => {
                "give `--recording`, `--rig`, `--camera` and `--marker`, or points as `x`, `y`, `z`"
            }
            Self::NoMarker { .. } => "find it first: `mirrorball-calib markers`",
            Self::NoFrame { .. } => "`sequence` is the frame's number in the recording",
            Self::Frame { .. } => "remove the alignment, or make it anew with the markers in view",
            Self::Solve(DisplayError::Plane { .. } | DisplayError::Depth { .. }) => {
                "align the point at distances from arm's length to several metres"
            }
            Self::Solve(DisplayError::Pixels) => "use crosses all over the display, as `--prompts` makes them",
            Self::Solve(DisplayError::TooFew { .. }) => "align more of the crosses",
            Self::Solve(_) => {
                "look whether u goes right and v down, and points are in the camera's frame: x right, y down, z forward"
            }
        })
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    if let (Some(folder), Some(size_px)) = (&args.prompts, args.size_px) {
        let prompts = prompts(size_px, args.points);
        write_prompts(folder, size_px, &prompts)?;
        return writeln!(
            out,
            "{} prompts in `{}`: show each at full size, bring the point behind the cross at about the distance it asks for, \
             hold still, and note number, u, v and where the point was",
            prompts.len(),
            folder.display()
        )
        .map_err(CommandError::Output);
    }
    let output = OutputArgs {
        out: None,
        json: args.json.clone(),
        report: args.report.clone(),
    };
    output.check()?;
    let file = args.alignments.as_deref().unwrap_or(Path::new(""));
    let alignments = alignments(args, file)?;
    let found = {
        let _progress = Progress::solve("finding eye and display");
        solve(&alignments).map_err(DisplayFailure::from)?
    };
    writeln!(out, "{}", sentences(&found).join("\n")).map_err(CommandError::Output)?;
    output.write_json(&Numbers::of(&found))?;
    output.write_report(|| report(&found))?;
    Ok(())
}

/// A cross to be shown.
struct Prompt {
    number: u32,
    pixel: [u32; 2],
    distance_m: f64,
}

/// Crosses that cover the display and all distances evenly however many of them are used (Halton 1960, bases 2, 3 and 5).
fn prompts(size_px: [u32; 2], n: u32) -> Vec<Prompt> {
    let along = |part: f64, size: u32| {
        let inner = 0.5 + INNER * (part - 0.5);
        (inner * f64::from(size - 1)).round() as u32
    };
    let prompt = |number: u32| Prompt {
        number,
        pixel: [
            along(radical_inverse(number, 2), size_px[0]),
            along(radical_inverse(number, 3), size_px[1]),
        ],
        distance_m: DISTANCES_M[(radical_inverse(number, 5) * DISTANCES_M.len() as f64) as usize],
    };
    (1..=n).map(prompt).collect()
}

/// The digits of a number in this base, behind the point in reverse.
fn radical_inverse(mut number: u32, base: u32) -> f64 {
    let (mut value, mut part) = (0.0, 1.0);
    while number > 0 {
        part /= f64::from(base);
        value += part * f64::from(number % base);
        number /= base;
    }
    value
}

fn write_prompts(folder: &Path, size_px: [u32; 2], prompts: &[Prompt]) -> Result<(), DisplayFailure> {
    let failed = |file: &Path, source: io::Error| DisplayFailure::Write {
        file: file.to_owned(),
        source,
    };
    fs::create_dir_all(folder).map_err(|source| failed(folder, source))?;
    let mut list = "number,u,v,distance_m\n".to_owned();
    for prompt in prompts {
        let [u, v] = prompt.pixel;
        list += &format!("{},{u},{v},{}\n", prompt.number, prompt.distance_m);
        let file = folder.join(format!("{:03}.png", prompt.number));
        let saved = picture(size_px, prompt).save(&file);
        saved.map_err(|error| failed(&file, io::Error::other(error)))?;
    }
    let file = folder.join("prompts.csv");
    fs::write(&file, list).map_err(|source| failed(&file, source))
}

/// A white cross on black, which a see-through display leaves clear; its pixel is where the lines meet.
fn picture([width, height]: [u32; 2], prompt: &Prompt) -> RgbImage {
    let mut picture = RgbImage::new(width, height);
    let (u, v) = (i64::from(prompt.pixel[0]), i64::from(prompt.pixel[1]));
    for i in -CROSS_PX..=CROSS_PX {
        canvas::put(&mut picture, (u + i, v), canvas::WHITE);
        canvas::put(&mut picture, (u, v + i), canvas::WHITE);
    }
    let number = prompt.number.to_string();
    canvas::text(&mut picture, &number, (u + CROSS_PX, v + 4), canvas::WHITE);
    let line = format!("{number}: point behind the cross, {} m away", prompt.distance_m);
    // At the edge that is farther from the cross.
    let top = if 2 * v > i64::from(height) {
        4
    } else {
        i64::from(height.saturating_sub(canvas::LINE_PX + 4))
    };
    let length = line.chars().count() as u32 * canvas::LETTER_PX;
    canvas::text(
        &mut picture,
        &line,
        (i64::from(width.saturating_sub(length) / 2), top),
        canvas::WHITE,
    );
    picture
}

fn alignments(args: &Args, file: &Path) -> Result<Vec<Alignment>, CommandError> {
    let table = Table::read(file)?;
    let points = if table.has("sequence") {
        points_seen(args, file, &table)?
    } else {
        let point = |index| Ok(DVec3::from_array(table.numbers(index, ["x", "y", "z"])?));
        (0..table.len()).map(point).collect::<Result<Vec<_>, TableError>>()?
    };
    let mut alignments = Vec::new();
    for (index, point) in points.into_iter().enumerate() {
        alignments.push(Alignment {
            number: number(&table, index)?,
            pixel: DVec2::from_array(table.numbers(index, ["u", "v"])?),
            point,
        });
    }
    Ok(alignments)
}

fn number(table: &Table, index: usize) -> Result<u32, TableError> {
    let number = table.whole(index, "number")?;
    u32::try_from(number).map_err(|_| table.value(index, "number", "0 to 4294967295"))
}

/// Where the marker's centre was in the camera's frame, from the frames named.
fn points_seen(args: &Args, file: &Path, table: &Table) -> Result<Vec<DVec3>, CommandError> {
    let (Some(recording), Some(rig), Some(name), Some(id)) = (&args.recording, &args.rig, &args.camera, args.marker)
    else {
        let file = file.to_owned();
        return Err(DisplayFailure::NoRecording { file }.into());
    };
    let rig = RigText::read(rig)?;
    let camera = rig.camera(name)?;
    let markers = &rig.parts.markers;
    let marker = markers.iter().find(|marker| marker.id == id);
    let marker = marker.ok_or(DisplayFailure::NoMarker { id })?;
    let pictures = Pictures::of_recording(recording)?;
    let seen = rig.look(pictures, std::slice::from_ref(&camera))?;
    let mut points = Vec::new();
    for index in 0..table.len() {
        let (number, sequence) = (number(table, index)?, table.whole(index, "sequence")?);
        let frame_name = format!("{name} {sequence}");
        let frame = seen.iter().find(|seen| seen.view.name == frame_name);
        let frame = frame.ok_or_else(|| DisplayFailure::NoFrame {
            number,
            sequence,
            camera: name.clone(),
        })?;
        let place = fixed(&camera.intrinsics, std::slice::from_ref(&frame.view), markers).map_err(|source| {
            DisplayFailure::Frame {
                number,
                sequence,
                source,
            }
        })?;
        points.push(place.pose.transform_point(marker.world_from_marker.translation));
    }
    Ok(points)
}

/// What the JSON file holds; its keys are an interface.
#[derive(Serialize)]
struct Numbers {
    routine: &'static str,
    projection: Rows,
    focal_px: [f64; 2],
    skew_px: f64,
    principal_point_px: [f64; 2],
    /// Of focal lengths, skew and principal point.
    intrinsics_sigma_px: [f64; 5],
    eye_from_headset: Rows,
    sigma: SigmaEntry,
    covariance: Vec<Vec<f64>>,
    rms_px: f64,
    alignment_sigma_px: f64,
    alignments: Vec<AlignmentEntry>,
}

#[derive(Serialize)]
struct AlignmentEntry {
    number: u32,
    pixel: [f64; 2],
    residual_px: [f64; 2],
    left_out_px: f64,
}

impl Numbers {
    fn of(found: &EyeDisplay) -> Self {
        let entry = |residual: &mirrorball_calib::extrinsics::display::AlignmentResidual| AlignmentEntry {
            number: residual.number,
            pixel: residual.pixel.to_array(),
            residual_px: residual.residual_px.to_array(),
            left_out_px: residual.left_out_px,
        };
        Self {
            routine: "display",
            projection: found.projection,
            focal_px: found.intrinsics.focal_px.to_array(),
            skew_px: found.intrinsics.skew_px,
            principal_point_px: found.intrinsics.principal_point_px.to_array(),
            intrinsics_sigma_px: found.intrinsics_sigma_px,
            eye_from_headset: rows(&found.eye_from_headset),
            sigma: found.sigma().into(),
            covariance: matrix_rows(&found.covariance),
            rms_px: found.rms_px,
            alignment_sigma_px: found.alignment_sigma_px,
            alignments: found.residuals.iter().map(entry).collect(),
        }
    }
}

fn sentences(found: &EyeDisplay) -> Vec<String> {
    let eye = 1e3 * found.eye_from_headset.inverse().translation;
    let sigma = SigmaEntry::from(found.sigma());
    let (display, sigmas) = (&found.intrinsics, found.intrinsics_sigma_px);
    let worst = found
        .residuals
        .iter()
        .max_by(|a, b| a.left_out_px.total_cmp(&b.left_out_px));
    vec![
        format!(
            "eye at {:.1} {:.1} {:.1} mm on the headset, σ {:.1} mm and {:.2}°",
            eye.x, eye.y, eye.z, sigma.place_mm, sigma.rotation_deg
        ),
        format!(
            "focal lengths {:.1} ± {:.1} and {:.1} ± {:.1} px, principal point {:.1} ± {:.1}, {:.1} ± {:.1} px, skew {:.1} ± {:.1} px",
            display.focal_px.x,
            sigmas[0],
            display.focal_px.y,
            sigmas[1],
            display.principal_point_px.x,
            sigmas[3],
            display.principal_point_px.y,
            sigmas[4],
            display.skew_px,
            sigmas[2]
        ),
        format!(
            "{} alignments, {:.2} px root mean square; left out in turn, number {} is worst: {:.2} px",
            found.residuals.len(),
            found.rms_px,
            worst.map_or(0, |worst| worst.number),
            worst.map_or(f64::NAN, |worst| worst.left_out_px)
        ),
    ]
}

fn report(found: &EyeDisplay) -> Report {
    let mut report = Report::new("Eye and display");
    for sentence in sentences(found) {
        report.push(Block::Text(sentence));
    }
    let far = found
        .residuals
        .iter()
        .fold(DVec2::ONE, |far, residual| far.max(residual.pixel));
    let vectors = found
        .residuals
        .iter()
        .map(|r| (r.pixel.to_array(), r.residual_px.to_array()));
    report.push(Block::Plot {
        caption: format!("Residuals on the display, {RESIDUAL_SCALE} times as long as they are"),
        plot: Plot::Vectors {
            size_px: [far.x.ceil() as u32 + 1, far.y.ceil() as u32 + 1],
            vectors: vectors.collect(),
            scale: RESIDUAL_SCALE,
        },
    });
    let points = found.residuals.iter().map(|r| [f64::from(r.number), r.left_out_px]);
    report.push(Block::Plot {
        caption:
            "Error at each alignment of the solution from all others. One far above the rest was a slip: make it anew."
                .to_owned(),
        plot: Plot::Chart {
            x: Axis::linear("number"),
            y: Axis::linear("error, px"),
            series: vec![Series {
                name: "left out".to_owned(),
                points: points.collect(),
                style: Style::Dots,
            }],
        },
    });
    report
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prompts_cover_the_display_and_all_distances() {
        let all = prompts([1280, 720], 24);
        let mut cells = std::collections::BTreeSet::new();
        for prompt in &all {
            let [u, v] = prompt.pixel;
            assert!((128..1152).contains(&u) && (72..648).contains(&v), "{u} {v}");
            cells.insert(((u - 128) / 342, (v - 72) / 192, (prompt.distance_m * 2.0) as u32));
        }
        // Nine cells of the display at three distances.
        assert!(cells.len() >= 18, "{}", cells.len());
    }

    #[test]
    fn the_cross_meets_at_its_pixel() {
        let prompt = Prompt {
            number: 7,
            pixel: [300, 80],
            distance_m: 1.0,
        };
        let picture = picture([640, 360], &prompt);
        let is_white = |x, y| picture.get_pixel(x, y).0 == [255; 3];
        assert!(is_white(300, 80) && is_white(277, 80) && is_white(300, 57));
        assert!(!is_white(299, 79) && !is_white(275, 80));
        assert!(
            (0..640).any(|x| (330..360).any(|y| is_white(x, y))),
            "a line says what to do"
        );
    }
}
