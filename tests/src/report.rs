//! A score as text.

use crate::{
    composite_error::{CompositeError, RegionError},
    environment_error::{EnvironmentError, FrameEnvironmentError},
    floors::Floor,
    pose_error::PoseError,
    psnr::Psnr,
    score::Score,
    stages::StageTime,
    statistics::Spread,
    truth::MaterialKind,
};

/// Lays a score out for a terminal.
pub fn text(score: &Score) -> String {
    let mut lines = vec![format!(
        "{}: {} scene frames with truth",
        score.sequence, score.scene_frames
    )];
    pose(&mut lines, &score.pose);
    environments(&mut lines, &score.environments);
    for error in &score.composites {
        composite(&mut lines, error);
    }
    stages(&mut lines, &score.stages);
    lines.join("\n") + "\n"
}

/// Lays out the comparison with the floors for a terminal.
pub fn floors_text(floors: &[Floor]) -> String {
    let mut lines = vec![String::new(), heading("Floors", &["measured", "floor", "", ""])];
    for floor in floors {
        let measured = floor
            .measured
            .map_or("none".to_owned(), |measured| format!("{measured:.3}"));
        let verdict = if floor.passed { "pass" } else { "FAIL" };
        lines.push(row(
            &floor.what,
            &[&measured, &floor.bound.to_string(), floor.unit, verdict],
        ));
    }
    let failed = floors.iter().filter(|floor| !floor.passed).count();
    lines.push(format!(
        "  {} of {} floors reached",
        floors.len() - failed,
        floors.len()
    ));
    lines.join("\n") + "\n"
}

/// A line of a table: a name and right-aligned cells.
fn row(name: &str, cells: &[&str]) -> String {
    let cells: String = cells.iter().map(|cell| format!("{cell:>11}")).collect();
    format!("  {name:<38}{cells}").trim_end().to_owned()
}

/// The first line of a table, not indented.
fn heading(name: &str, cells: &[&str]) -> String {
    let cells: String = cells.iter().map(|cell| format!("{cell:>11}")).collect();
    format!("{name:<40}{cells}").trim_end().to_owned()
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

fn decibels(psnr: Option<Psnr>) -> String {
    psnr.map_or("-".to_owned(), |psnr| psnr.to_string())
}

fn pose(lines: &mut Vec<String>, pose: &PoseError) {
    lines.extend([String::new(), heading("Pose", &["median", "p95", "worst"])]);
    let mut spread = |name: &str, spread: Option<Spread>| {
        let cells = [spread.map(|s| s.median), spread.map(|s| s.p95), spread.map(|s| s.worst)];
        let [median, p95, worst] = cells.map(|cell| number(cell, 3));
        lines.push(row(name, &[&median, &p95, &worst]));
    };
    spread("camera centre, mm", pose.centre_mm);
    spread("rotation, deg", pose.rotation_deg);
    spread("reprojection error as reported, px", pose.reported_reprojection_px);
    lines.push(format!(
        "  {} frames compared, {} lost",
        pose.frames.len(),
        pose.lost.len()
    ));
    lines.extend(
        pose.lost
            .iter()
            .map(|lost| format!("    frame {} lost: {}", lost.frame, lost.reason)),
    );
    if !pose.without_truth.is_empty() {
        let frames: Vec<_> = pose.without_truth.iter().map(u32::to_string).collect();
        lines.push(format!(
            "  {} frames without truth, not compared: {}",
            frames.len(),
            frames.join(" ")
        ));
    }
}

/// A figure of the environment comparison, with its name.
type EnvironmentFigure = (&'static str, fn(&FrameEnvironmentError) -> Option<f64>);

/// The figures of the environment comparison in the order they are printed.
const ENVIRONMENT_FIGURES: [EnvironmentFigure; 9] = [
    ("brightest light, deg", |frame| frame.light_deg),
    ("irradiance, all normals, mean, %", |frame| {
        Some(frame.irradiance.mean_percent)
    }),
    ("irradiance, all normals, worst, %", |frame| {
        Some(frame.irradiance.worst_percent)
    }),
    ("irradiance, upper normals, mean, %", |frame| {
        Some(frame.irradiance.upper_mean_percent)
    }),
    ("irradiance, upper normals, worst, %", |frame| {
        Some(frame.irradiance.upper_worst_percent)
    }),
    ("irradiance, red, mean, %", |frame| {
        Some(frame.irradiance.rgb_mean_percent[0])
    }),
    ("irradiance, green, mean, %", |frame| {
        Some(frame.irradiance.rgb_mean_percent[1])
    }),
    ("irradiance, blue, mean, %", |frame| {
        Some(frame.irradiance.rgb_mean_percent[2])
    }),
    ("unclipped radiance above table, %", |frame| frame.unclipped_percent),
];

fn environments(lines: &mut Vec<String>, environments: &[EnvironmentError]) {
    for environment in environments {
        let place = if environment.is_probe {
            "at the probe"
        } else {
            "at object"
        };
        lines.push(String::new());
        if environment.frames.is_empty() {
            lines.push(format!("Environment {place} `{}`: no map written", environment.at));
            continue;
        }
        let frames = format!("{} frames", environment.frames.len());
        let name = format!("Environment {place} `{}`", environment.at);
        lines.push(heading(&name, &["median", "worst", &frames]));
        for (name, figure) in ENVIRONMENT_FIGURES {
            if let Some(median) = environment.median(figure) {
                lines.push(row(
                    name,
                    &[&number(Some(median), 2), &number(environment.worst(figure), 2)],
                ));
            }
        }
        if let Some(radius_deg) = environment.true_light_radius_deg {
            lines.push(format!(
                "  the true light fills a cone of {radius_deg:.1} deg around its direction"
            ));
        }
    }
}

fn composite(lines: &mut Vec<String>, error: &CompositeError) {
    let name = format!("Composite of frame {}", error.frame);
    lines.extend([
        String::new(),
        heading(&name, &["pixels", "PSNR, dB", "untouched", "FLIP", "untouched"]),
    ]);
    let mut region = |name: &str, region: &RegionError| {
        let [psnr, untouched_psnr] = [region.psnr_db, region.untouched_psnr_db].map(decibels);
        let [flip, untouched_flip] = [region.flip, region.untouched_flip].map(|flip| number(flip, 3));
        lines.push(row(
            name,
            &[
                &region.pixels.to_string(),
                &psnr,
                &untouched_psnr,
                &flip,
                &untouched_flip,
            ],
        ));
    };
    region("object", &error.object);
    for object in &error.objects {
        region(
            &format!("  {} ({})", object.name, material_name(object.material)),
            &object.region,
        );
    }
    region("shadow", &error.shadow);
    region("unchanged", &error.unchanged);
    region("whole picture", &error.whole);
    lines.push(row(
        "unchanged, against the camera's frame",
        &[
            &error.unchanged.pixels.to_string(),
            &decibels(error.unchanged_against_camera),
        ],
    ));
    lines.push(format!(
        "  {} pixels outside every phantom and object, {} of them not the camera's",
        error.outside_pixels, error.outside_pixels_changed
    ));
}

fn material_name(material: MaterialKind) -> &'static str {
    match material {
        MaterialKind::Diffuse => "diffuse",
        MaterialKind::Metal => "metal",
        MaterialKind::Mirror => "mirror",
    }
}

fn stages(lines: &mut Vec<String>, stages: &[StageTime]) {
    if stages.is_empty() {
        return;
    }
    lines.extend([String::new(), heading("Time per stage", &["median, ms", "frames"])]);
    for stage in stages {
        lines.push(row(
            &stage.name,
            &[&format!("{:.2}", stage.median_ms), &stage.frames.to_string()],
        ));
    }
}
