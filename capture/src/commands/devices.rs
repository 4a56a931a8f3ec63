//! `devices`: cameras with their formats and controls, for people or as JSON.

use std::io::{self, Write};
use std::process::ExitCode;

use clap::Args;
use mirrorball_capture::v4l2::{
    Camera, CameraAddress, CameraNode, ControlDescription, FormatKind, FormatOffer, Intervals, Sizes, V4l2Error,
    list_nodes,
};
use serde_json::{Value, json};

#[derive(Debug, Args)]
pub(crate) struct DevicesArgs {
    /// Print one JSON array instead of text.
    #[arg(long)]
    json: bool,
}

/// What is inside a camera, once it is open.
struct Inside {
    driver: String,
    bus: String,
    formats: Vec<FormatOffer>,
    controls: Vec<ControlDescription>,
}

/// Prints all cameras. One that cannot be opened is listed with the reason.
pub(crate) fn run(args: &DevicesArgs) -> io::Result<ExitCode> {
    let cameras = list_nodes().into_iter().filter(|node| node.index == 0);
    let cameras: Vec<_> = cameras.map(|node| (look_inside(&node), node)).collect();
    let mut out = io::stdout().lock();
    if args.json {
        let all: Vec<_> = cameras.iter().map(|(inside, node)| to_json(node, inside)).collect();
        writeln!(out, "{:#}", Value::Array(all))?;
        return Ok(ExitCode::SUCCESS);
    }
    if cameras.is_empty() {
        writeln!(out, "no cameras")?;
    }
    for (inside, node) in &cameras {
        print(&mut out, node, inside)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn look_inside(node: &CameraNode) -> Result<Inside, V4l2Error> {
    let camera = Camera::open(&CameraAddress::Path(node.path.clone()))?;
    Ok(Inside {
        driver: camera.driver().to_owned(),
        bus: camera.bus().to_owned(),
        formats: camera.offers()?,
        // Without its controls the camera is still worth listing.
        controls: camera.controls().list().unwrap_or_default(),
    })
}

fn print(out: &mut impl Write, node: &CameraNode, inside: &Result<Inside, V4l2Error>) -> io::Result<()> {
    writeln!(out, "{}: {}", node.path.display(), node.address())?;
    if let Some(usb) = &node.usb {
        writeln!(
            out,
            "  usb: bus {}, hub {}, {} Mbit/s",
            usb.bus_number, usb.hub, usb.speed_mbit
        )?;
    }
    let inside = match inside {
        Ok(inside) => inside,
        Err(error) => return writeln!(out, "  error: {error}\n  hint: {}", error.hint()),
    };
    writeln!(out, "  driver: {} at {}", inside.driver, inside.bus)?;
    let (ours, others): (Vec<_>, Vec<_>) = inside
        .formats
        .iter()
        .partition(|format| FormatKind::from_fourcc(format.fourcc).is_some());
    for format in ours {
        writeln!(out, "  format {}: {}", format.code(), format.name)?;
        for offer in &format.sizes {
            writeln!(
                out,
                "    {} at {}",
                size_text(&offer.sizes),
                rate_text(&offer.intervals)
            )?;
        }
    }
    if !others.is_empty() {
        let codes: Vec<_> = others.iter().map(|format| format.code()).collect();
        writeln!(out, "  formats that are not taken: {}", codes.join(", "))?;
    }
    for control in &inside.controls {
        writeln!(out, "  control {}", control_text(control))?;
        for (value, name) in &control.menu {
            writeln!(out, "    {value}: {name}")?;
        }
    }
    Ok(())
}

fn size_text(sizes: &Sizes) -> String {
    match sizes {
        Sizes::Discrete(size) => format!("{}x{}", size.width, size.height),
        Sizes::Stepwise { least, most, step } => format!(
            "{}x{} to {}x{} in steps of {}x{}",
            least.width, least.height, most.width, most.height, step.width, step.height
        ),
    }
}

fn rate_text(intervals: &Intervals) -> String {
    match intervals {
        Intervals::Unknown => "unknown rates".into(),
        Intervals::Discrete(all) => {
            let rates: Vec<_> = all
                .iter()
                .map(|interval| hundredths(interval.frames_per_s()).to_string())
                .collect();
            format!("{} frames/s", rates.join(", "))
        }
        Intervals::Between(shortest, longest) => format!(
            "{} to {} frames/s",
            hundredths(longest.frames_per_s()),
            hundredths(shortest.frames_per_s())
        ),
    }
}

fn hundredths(rate: f64) -> f64 {
    (rate * 100.0).round() / 100.0
}

fn control_text(control: &ControlDescription) -> String {
    let ControlDescription {
        name,
        kind,
        minimum,
        maximum,
        step,
        default,
        ..
    } = control;
    let mut text = format!("{name} ({kind}): {minimum}..={maximum}");
    if *step > 1 {
        text += &format!(" in steps of {step}");
    }
    if !control.unit.is_empty() {
        text += &format!(", unit {}", control.unit);
    }
    text += &format!(", default {default}");
    if let Some(value) = control.value {
        text += &format!(", now {value}");
    }
    if !control.restrictions.is_empty() {
        text += &format!(" ({})", control.restrictions.join(", "));
    }
    text
}

fn to_json(node: &CameraNode, inside: &Result<Inside, V4l2Error>) -> Value {
    let usb = node.usb.as_ref().map(
        |usb| json!({ "bus": usb.bus, "hub": usb.hub, "bus_number": usb.bus_number, "speed_mbit": usb.speed_mbit }),
    );
    let path = node.path.display().to_string();
    let mut camera = json!({ "path": path, "name": node.name, "address": node.address().to_string(), "usb": usb });
    match inside {
        Ok(inside) => {
            camera["driver"] = json!(inside.driver);
            camera["bus"] = json!(inside.bus);
            camera["formats"] = inside.formats.iter().map(format_json).collect();
            camera["controls"] = inside.controls.iter().map(control_json).collect();
        }
        Err(error) => camera["error"] = json!({ "message": error.to_string(), "hint": error.hint() }),
    }
    camera
}

fn format_json(format: &FormatOffer) -> Value {
    let sizes: Vec<_> = format
        .sizes
        .iter()
        .map(|offer| {
            let rates = match &offer.intervals {
                Intervals::Unknown => Value::Null,
                Intervals::Discrete(all) => all.iter().map(|interval| interval.frames_per_s()).collect(),
                Intervals::Between(shortest, longest) => {
                    json!({ "least": longest.frames_per_s(), "most": shortest.frames_per_s() })
                }
            };
            let size = match &offer.sizes {
                Sizes::Discrete(size) => json!([size.width, size.height]),
                Sizes::Stepwise { least, most, step } => json!({
                    "least": [least.width, least.height],
                    "most": [most.width, most.height],
                    "step": [step.width, step.height],
                }),
            };
            json!({ "size_px": size, "frames_per_s": rates })
        })
        .collect();
    json!({ "fourcc": format.code(), "name": format.name, "sizes": sizes })
}

fn control_json(control: &ControlDescription) -> Value {
    let menu: Vec<_> = control
        .menu
        .iter()
        .map(|(value, name)| json!({ "value": value, "name": name }))
        .collect();
    json!({
        "id": control.id,
        "name": control.name,
        "kind": control.kind,
        "minimum": control.minimum,
        "maximum": control.maximum,
        "step": control.step,
        "default": control.default,
        "value": control.value,
        "unit": control.unit,
        "menu": menu,
        "restrictions": control.restrictions,
    })
}
