//! `timing`: offset and drift between two cameras' clocks, and the latency from an event to its picture on a display.

mod report;
mod signals;

use std::{io, io::Write, path::PathBuf};

use mirrorball_calib::timing::{
    ClockOffset, Sample, Stamp, TimingError, align,
    blink::{self, Edge},
    latency::{self, Latency},
    motion::{self, Sighting},
};
use serde::Serialize;

use super::{CommandError, explain::Explain, input::InputArgs, output::OutputArgs};

/// Standard deviation of an offset beyond which more pictures are asked for, milliseconds.
const WANTED_MS: f64 = 0.25;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// The two cameras, A and B, whose clocks are compared.
    #[arg(long, value_name = "A,B", value_delimiter = ',', required_unless_present = "camera")]
    cameras: Vec<String>,
    /// What both cameras see: a light that blinks irregularly, or a marker that moves.
    #[arg(long, value_enum, default_value_t = Kind::Blink)]
    kind: Kind,
    /// Region of the pictures that blinks; by default found.
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    region: Option<Region>,
    /// The camera that films the display and the event.
    #[arg(long, value_name = "NAME", conflicts_with = "cameras", requires_all = ["display_region", "event_region"])]
    camera: Option<String>,
    /// Where that camera sees the display's picture of the event.
    #[arg(long, value_name = "X,Y,W,H", value_parser = region, requires = "camera")]
    display_region: Option<Region>,
    /// Where it sees the event itself, a light that blinks.
    #[arg(long, value_name = "X,Y,W,H", value_parser = region, requires = "camera")]
    event_region: Option<Region>,
    /// What of an exposure the time stamps mark.
    #[arg(long, value_enum, default_value_t = StampArg::Start)]
    stamps: StampArg,
    /// Offsets up to this are looked for, either way; latencies up to this.
    #[arg(long, value_name = "MS", default_value_t = 500.0)]
    max_ms: f64,
    /// Number of the marker that moves; by default the one that both see most often.
    #[arg(long, value_name = "ID")]
    marker: Option<u32>,
    /// File for the numbers.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// File for a page with the signals.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

impl Args {
    /// A rig file holds no times: there is no `--out`.
    fn outputs(&self) -> OutputArgs {
        OutputArgs {
            out: None,
            json: self.json.clone(),
            report: self.report.clone(),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    Blink,
    Motion,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum StampArg {
    Start,
    Middle,
    End,
}

impl From<StampArg> for Stamp {
    fn from(stamp: StampArg) -> Self {
        match stamp {
            StampArg::Start => Self::Start,
            StampArg::Middle => Self::Middle,
            StampArg::End => Self::End,
        }
    }
}

/// A rectangle of pixels: left, top, width, height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Region([u32; 4]);

fn region(text: &str) -> Result<Region, String> {
    let values: Result<Vec<u32>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match values.as_deref() {
        Ok(&[x, y, width, height]) if width > 0 && height > 0 => Ok(Region([x, y, width, height])),
        _ => Err("left, top, width and height in pixels are needed, with commas between them".to_owned()),
    }
}

/// Why there are no times.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TimingCommandError {
    #[error("`{n}` cameras are named (allowed: 2)")]
    Cameras { n: usize },
    #[error("`--cameras` names camera `{camera}` twice (allowed: two different ones)")]
    OneCamera { camera: String },
    #[error("`--max-ms` is `{value}` (allowed: above 0, at most 10000)")]
    Range { value: f64 },
    #[error("pictures in a folder have no time stamps")]
    NoTime,
    #[error("the recording has no picture of camera `{camera}`")]
    NoPicture { camera: String },
    #[error("region `{}` of camera `{camera}` lies outside its pictures of `{}×{}`", .region.map(|v| v.to_string()).join(","), size[0], size[1])]
    Region {
        camera: String,
        region: [u32; 4],
        size: [u32; 2],
    },
    #[error("no marker is seen by both cameras")]
    NoMarker,
    #[error("picture `{picture}` cannot be searched")]
    Search {
        picture: String,
        #[source]
        source: mirrorball_calib::tag::LumaError,
    },
    #[error("cannot tell the times")]
    Timing(#[from] TimingError),
}

impl Explain for TimingCommandError {
    fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Timing(TimingError::NotConverged))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::Cameras { .. } | Self::OneCamera { .. } => "give `--cameras A,B`",
            Self::Range { .. } | Self::Search { .. } => return None,
            Self::NoTime => "give a recording",
            Self::NoPicture { .. } => "name cameras of the recording",
            Self::Region { .. } => "give left, top, width and height within the picture",
            Self::NoMarker => "move one marker in view of both cameras, or name it with `--marker`",
            Self::Timing(error) => match error {
                TimingError::NothingBlinks { .. } => {
                    "let a light blink in view of all cameras, or name where it is with `--region`"
                }
                TimingError::Saturated { .. } => "shorten the exposure or dim the light",
                TimingError::TooFewEdges { .. } => "blink slower than three frames a change, and record longer",
                TimingError::Ambiguous { .. } => {
                    "blink or move irregularly, or say with `--max-ms` that the offset is less than half of that"
                }
                TimingError::NoAgreement { .. } => {
                    "both must see the same light or marker; raise `--max-ms` if clocks may differ by more"
                }
                TimingError::NotConverged => "record longer, with more movement",
                TimingError::NothingMoves { .. } => "move the marker to and fro across both pictures, irregularly",
                TimingError::TooFewPictures { .. } => "record longer, with the marker in view of both cameras",
            },
        })
    }
}

/// What was compared.
enum Signals {
    Light([Vec<Sample>; 2]),
    Path([Vec<Sighting>; 2]),
}

enum Outcome {
    Clocks(ClockOffset),
    Latency(Latency),
}

struct Found {
    names: [String; 2],
    signals: Signals,
    outcome: Outcome,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.outputs().check()?;
    if !(args.max_ms > 0.0 && args.max_ms <= 10_000.0) {
        return Err(TimingCommandError::Range { value: args.max_ms }.into());
    }
    let found = match (&args.camera, args.kind) {
        (Some(camera), _) => display(args, camera)?,
        (None, Kind::Blink) => blinking(args)?,
        (None, Kind::Motion) => moving(args)?,
    };
    found.print(out).map_err(CommandError::Output)?;
    args.outputs().write_json(&Told {
        routine: "timing",
        numbers: found.numbers(),
    })?;
    args.outputs().write_report(|| report::report(&found))?;
    Ok(())
}

fn pair(args: &Args) -> Result<[String; 2], TimingCommandError> {
    let n = args.cameras.len();
    let names: [String; 2] = args
        .cameras
        .clone()
        .try_into()
        .map_err(|_| TimingCommandError::Cameras { n })?;
    if names[0] == names[1] {
        return Err(TimingCommandError::OneCamera {
            camera: names[0].clone(),
        });
    }
    Ok(names)
}

fn blinking(args: &Args) -> Result<Found, CommandError> {
    let names = pair(args)?;
    let wanted = names.each_ref().map(|name| (name.as_str(), args.region));
    let light = signals::light(&args.input, &wanted, args.stamps.into())?;
    let edges = edges(&light, &names)?;
    let clocks = align::clock_offset(&edges[0], &edges[1], 1e-3 * args.max_ms).map_err(TimingCommandError::from)?;
    Ok(Found {
        names,
        signals: Signals::Light(light),
        outcome: Outcome::Clocks(clocks),
    })
}

fn display(args: &Args, camera: &str) -> Result<Found, CommandError> {
    let wanted = [(camera, args.event_region), (camera, args.display_region)];
    let light = signals::light(&args.input, &wanted, args.stamps.into())?;
    let names = ["event", "display"].map(str::to_owned);
    let edges = edges(&light, &names)?;
    let latency = latency::latency(&edges[0], &edges[1], 1e-3 * args.max_ms).map_err(TimingCommandError::from)?;
    Ok(Found {
        names,
        signals: Signals::Light(light),
        outcome: Outcome::Latency(latency),
    })
}

fn moving(args: &Args) -> Result<Found, CommandError> {
    let names = pair(args)?;
    let paths = signals::paths(&args.input, &names, args.stamps.into(), args.marker)?;
    let clocks = motion::clock_offset(&paths[0], &paths[1], 1e-3 * args.max_ms).map_err(TimingCommandError::from)?;
    Ok(Found {
        names,
        signals: Signals::Path(paths),
        outcome: Outcome::Clocks(clocks),
    })
}

fn edges(light: &[Vec<Sample>; 2], names: &[String; 2]) -> Result<[Vec<Edge>; 2], TimingCommandError> {
    Ok([blink::edges(&light[0], &names[0])?, blink::edges(&light[1], &names[1])?])
}

/// What `--json` writes; its keys are an interface.
#[derive(Serialize)]
struct Told {
    routine: &'static str,
    #[serde(flatten)]
    numbers: Numbers,
}

#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Numbers {
    Clocks {
        a: String,
        b: String,
        /// t_b - t_a of one event.
        offset_ms: f64,
        offset_sigma_ms: f64,
        drift_ppm: f64,
        drift_sigma_ppm: f64,
        /// On A's clock, from the recording's first frame.
        at_s: f64,
        n_used: usize,
        agreeing: f64,
    },
    Latency {
        mean_ms: f64,
        mean_sigma_ms: f64,
        spread_ms: f64,
        range_ms: [f64; 2],
        n_used: usize,
    },
}

impl Found {
    fn numbers(&self) -> Numbers {
        match &self.outcome {
            Outcome::Clocks(clocks) => Numbers::Clocks {
                a: self.names[0].clone(),
                b: self.names[1].clone(),
                offset_ms: 1e3 * clocks.offset_s,
                offset_sigma_ms: 1e3 * clocks.offset_sigma_s,
                drift_ppm: 1e6 * clocks.drift,
                drift_sigma_ppm: 1e6 * clocks.drift_sigma,
                at_s: clocks.at_s,
                n_used: clocks.n_used,
                agreeing: clocks.agreeing,
            },
            Outcome::Latency(latency) => Numbers::Latency {
                mean_ms: 1e3 * latency.mean_s,
                mean_sigma_ms: 1e3 * latency.mean_sigma_s,
                spread_ms: 1e3 * latency.spread_s,
                range_ms: latency.range_s.map(|s| 1e3 * s),
                n_used: latency.each_s.len(),
            },
        }
    }

    fn print(&self, out: &mut impl Write) -> io::Result<()> {
        match self.numbers() {
            Numbers::Clocks {
                a,
                b,
                offset_ms,
                offset_sigma_ms,
                drift_ppm,
                drift_sigma_ppm,
                n_used,
                ..
            } => {
                writeln!(
                    out,
                    "`{b}` is {offset_ms:+.3} ms (± {offset_sigma_ms:.3}) on `{a}`, for one event"
                )?;
                writeln!(
                    out,
                    "drift {drift_ppm:+.1} ppm (± {drift_sigma_ppm:.1}); {n_used} changes or pictures compared"
                )?;
                if offset_sigma_ms > WANTED_MS {
                    writeln!(
                        out,
                        "warning: the offset may be off by more than half a millisecond: expose for half of the frame interval, or record longer"
                    )?;
                }
                Ok(())
            }
            Numbers::Latency {
                mean_ms,
                mean_sigma_ms,
                spread_ms,
                range_ms,
                n_used,
            } => writeln!(
                out,
                "latency {mean_ms:.2} ms (± {mean_sigma_ms:.2}), spread {spread_ms:.2} ms, {:.1} to {:.1} ms; {n_used} changes",
                range_ms[0], range_ms[1]
            ),
        }
    }
}
