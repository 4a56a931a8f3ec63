//! `intrinsics`: a camera's lens from pictures of a board.

mod corners;
mod error;
mod look;
mod numbers;
mod page;

use std::{fs, io::Write, path::PathBuf};

use mirrorball_calib::{
    board::{Board, BoardView},
    camera::Model,
    intrinsics::{Calibration, Guide, Request, calibrate},
    response::ResponseCurve,
    rig::{RigDraft, Role},
};

use super::{
    CommandError,
    input::InputArgs,
    output::{OutputArgs, draft},
    progress::Progress,
};
use error::IntrinsicsCommandError;

/// Pictures without a board that the table names; the page and the numbers name all.
const NAMED: usize = 10;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// Corners found before, as JSON (`--corners-out`), in place of pictures.
    #[arg(long, value_name = "FILE", group = "input")]
    corners: Option<PathBuf>,
    /// File for the corners that are found.
    #[arg(long, value_name = "FILE")]
    corners_out: Option<PathBuf>,
    /// The board: our TOML, or Kalibr's YAML.
    #[arg(long, value_name = "FILE")]
    board: PathBuf,
    /// Lens model.
    #[arg(long)]
    model: Model,
    /// The camera's name in the rig file; of a recording, only its frames are looked at.
    #[arg(long, value_name = "NAME", default_value = "scene")]
    camera: String,
    /// What the camera is for; unless given, what the rig file says, or `scene`.
    #[arg(long, value_parser = role)]
    role: Option<Role>,
    /// Angle to a fisheye's axis beyond which it images nothing; unless given, as far as corners were seen, or to the picture's
    /// corners where the lens fills them.
    #[arg(long, value_name = "DEGREES", value_parser = angle)]
    max_angle_deg: Option<f64>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The views of a board, and what became of the other pictures.
struct Views {
    size_px: [u32; 2],
    views: Vec<BoardView>,
    /// Width of the edges in each, where it is known.
    edge_widths_px: Vec<Option<f64>>,
    /// Pictures without a board: name and reason.
    not_found: Vec<(String, String)>,
    /// Views that say what others say too, and are not solved for.
    n_alike: usize,
}

/// Everything there is to tell.
struct Outcome<'a> {
    args: &'a Args,
    board: &'a Board,
    views: &'a Views,
    calibration: &'a Calibration,
    guide: &'a Guide,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output.check()?;
    let board = read_board(args)?;
    let mut rig = match &args.output.out {
        Some(file) => draft(file)?,
        None => RigDraft::new(),
    };
    let views = match &args.corners {
        Some(file) => corners::read(file)?,
        None => look::look(args, &board, &response(args, &rig)?)?,
    };
    if let Some(file) = &args.corners_out {
        corners::write(file, &views)?;
    }
    check_size(args, &rig, views.size_px)?;
    let request = Request {
        board: &board,
        size_px: views.size_px,
        model: args.model,
        max_angle_rad: args.max_angle_deg.map(f64::to_radians),
    };
    let calibration = {
        let progress = Progress::solve("solving for the lens");
        calibrate(&request, &views.views, &mut |iteration| progress.iteration(&iteration))
            .map_err(IntrinsicsCommandError::Calibrate)?
    };
    let guide = guide(&board, &views, &calibration);
    let outcome = Outcome {
        args,
        board: &board,
        views: &views,
        calibration: &calibration,
        guide: &guide,
    };
    set(&mut rig, args, &calibration)?;
    args.output.write_json(&numbers::numbers(&outcome))?;
    args.output.write_report(|| page::page(&outcome))?;
    args.output.write_rig(&rig)?;
    write_table(&outcome, out).map_err(CommandError::Output)
}

fn role(name: &str) -> Result<Role, String> {
    let role = Role::ALL.into_iter().find(|role| role.name() == name);
    role.ok_or_else(|| {
        format!(
            "allowed: {}",
            Role::ALL.map(|role| format!("`{}`", role.name())).join(", ")
        )
    })
}

fn angle(text: &str) -> Result<f64, String> {
    let degrees: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    (degrees > 1.0 && degrees < 180.0)
        .then_some(degrees)
        .ok_or_else(|| "allowed: above 1, below 180".to_owned())
}

fn read_board(args: &Args) -> Result<Board, IntrinsicsCommandError> {
    let text = fs::read_to_string(&args.board).map_err(|source| IntrinsicsCommandError::ReadBoard {
        file: args.board.clone(),
        source,
    })?;
    Board::from_text(&text, &args.board).map_err(|source| IntrinsicsCommandError::Board {
        file: args.board.clone(),
        source: Box::new(source),
    })
}

/// The response that the rig file has for the camera; sRGB as long as it has none.
fn response(args: &Args, rig: &RigDraft) -> Result<ResponseCurve, IntrinsicsCommandError> {
    let Some(file) = &args.output.out else {
        return Ok(ResponseCurve::srgb());
    };
    let parts = rig.parts(file).map_err(|source| IntrinsicsCommandError::Rig {
        file: file.clone(),
        source: Box::new(source),
    })?;
    let photometry = parts.camera(&args.camera).and_then(|camera| camera.photometry.as_ref());
    Ok(photometry.map_or_else(ResponseCurve::srgb, |photometry| photometry.response.clone()))
}

/// The size of a camera that the rig knows stays: where the camera stands and what it sees belong to it.
fn check_size(args: &Args, rig: &RigDraft, size_px: [u32; 2]) -> Result<(), IntrinsicsCommandError> {
    let Some(file) = &args.output.out else { return Ok(()) };
    let parts = rig.parts(file).map_err(|source| IntrinsicsCommandError::Rig {
        file: file.clone(),
        source: Box::new(source),
    })?;
    match parts.camera(&args.camera) {
        Some(camera) if camera.size_px != size_px => Err(IntrinsicsCommandError::Size {
            file: file.clone(),
            camera: args.camera.clone(),
            known_px: camera.size_px,
            found_px: size_px,
        }),
        Some(_) | None => Ok(()),
    }
}

/// What the views that took part cover.
fn guide(board: &Board, views: &Views, calibration: &Calibration) -> Guide {
    let mut guide = Guide::new(board, views.size_px, calibration.intrinsics.lens.model());
    guide.set_lens(&calibration.intrinsics);
    for (view, width) in views.views.iter().zip(&views.edge_widths_px) {
        if calibration.views.iter().any(|used| used.name == view.name) {
            guide.add(view, *width);
        }
    }
    guide
}

/// Writes the lens into the rig; the camera keeps what it is for unless another role is asked for.
fn set(rig: &mut RigDraft, args: &Args, calibration: &Calibration) -> Result<(), IntrinsicsCommandError> {
    let Some(file) = &args.output.out else { return Ok(()) };
    let parts = rig.parts(file).map_err(|source| IntrinsicsCommandError::Rig {
        file: file.clone(),
        source: Box::new(source),
    })?;
    let known = parts.camera(&args.camera);
    let role = args.role.or(known.map(|camera| camera.role)).unwrap_or(Role::Scene);
    rig.set_camera(&args.camera, role, calibration.intrinsics.size_px);
    rig.set_lens(&args.camera, &calibration.intrinsics);
    Ok(())
}

fn write_table(outcome: &Outcome<'_>, out: &mut impl Write) -> std::io::Result<()> {
    let Calibration {
        intrinsics,
        views,
        rms_px,
        ..
    } = outcome.calibration;
    let corners: usize = views.iter().map(|view| view.residuals.len()).sum();
    let [width, height] = intrinsics.size_px;
    let model = intrinsics.lens.model();
    writeln!(out, "camera {}: {model}, {width} x {height} px", outcome.args.camera)?;
    writeln!(out, "{} views, {corners} corners, rms {rms_px:.4} px", views.len())?;
    writeln!(out, "\nparameter          value         sigma")?;
    let values = intrinsics.parameters();
    for ((name, value), sigma) in model
        .parameter_names()
        .iter()
        .zip(values)
        .zip(outcome.calibration.sigmas())
    {
        writeln!(out, "{name:<9} {value:>14.6} {sigma:>13.6}")?;
    }
    if let Some(angle) = page::max_angle_deg(intrinsics) {
        writeln!(out, "imaged to {angle:>14.2} degrees from the axis")?;
    }
    let [x, y, twist] = outcome.calibration.board_warp_m.map(|metres| 1e3 * metres);
    writeln!(
        out,
        "board bent by {x:.3} mm along x, {y:.3} mm along y, twisted by {twist:.3} mm"
    )?;
    if let Some(map) = page::uncertainty(outcome.calibration) {
        let (rms, worst) = (map.rms_px(), map.worst_px());
        writeln!(out, "projection known to {rms:.4} px (rms), {worst:.4} px (worst)")?;
    }
    writeln!(out, "\nview                          corners  rms px  worst px  out")?;
    for view in views {
        let rejected = outcome
            .calibration
            .rejected_corners
            .iter()
            .filter(|corner| corner.view == view.name)
            .count();
        let (name, corners) = (&view.name, view.residuals.len());
        writeln!(
            out,
            "{name:<29} {corners:>7} {:>7.3} {:>9.3} {rejected:>4}",
            view.rms_px, view.worst_px
        )?;
    }
    let rejected = page::rejected(outcome);
    for (name, reason) in rejected.iter().take(NAMED) {
        writeln!(out, "{name:<29} not used: {reason}")?;
    }
    if rejected.len() > NAMED {
        writeln!(out, "and {} more that were not used", rejected.len() - NAMED)?;
    }
    if outcome.views.n_alike > 0 {
        writeln!(
            out,
            "{} views that others resemble were left out",
            outcome.views.n_alike
        )?;
    }
    for warning in page::warnings(outcome) {
        writeln!(out, "warning: {warning}")?;
    }
    Ok(())
}
