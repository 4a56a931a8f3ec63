//! `color --white-balance`: which setting of the second camera goes with which of the first.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::{self, Write},
    path::Path,
};

use mirrorball_calib::{
    color::white_balance::{Agreement, GreyAt, GreyReading, WhiteBalanceTable, white_balance_table},
    report::{
        Block, Plot, Report,
        plot::{Axis, Series, Style},
    },
    rig::Camera,
};
use serde::Serialize;

use super::{ColorError, Task, read};
use crate::commands::{CommandError, csv::Table};

/// Difference (CIEDE2000) above which the best setting is called unsatisfactory: a patient eye sees it.
const VISIBLE: f64 = 2.0;

/// What the drivers were set to: by camera and frame.
type Settings = BTreeMap<(String, u64), f64>;

/// What is told.
struct Told<'a> {
    cameras: [&'a Camera; 2],
    table: WhiteBalanceTable,
    pictures: [usize; 2],
    /// Pictures whose setting the table of settings does not tell.
    without_setting: usize,
    /// What a setting is.
    scale: &'static str,
}

pub(super) fn run(task: &Task<'_>, cameras: [&Camera; 2], out: &mut impl Write) -> Result<(), CommandError> {
    let settings = task.args.settings.as_deref().map(read_settings).transpose()?;
    if !task.sheet.patches.iter().any(|patch| patch.is_neutral) {
        return Err(ColorError::NoNeutral.into());
    }
    let mut readings = [Vec::new(), Vec::new()];
    let mut without_setting = BTreeSet::new();
    let pictures = read::visit(task, cameras, |found| {
        let patch = &task.sheet.patches[found.patch];
        if !patch.is_neutral {
            return;
        }
        let gains = found.exposure.white_balance;
        let setting = match &settings {
            None => Some(gains[0] / gains[2]),
            Some(settings) => found.picture.sequence.and_then(|frame| {
                let key = (cameras[found.camera].name.clone(), frame);
                settings.get(&key).copied()
            }),
        };
        let Some(setting) = setting else {
            without_setting.insert(found.picture.name.clone());
            return;
        };
        readings[found.camera].push(GreyReading {
            setting,
            gains,
            patch: patch.name.clone(),
            light: found.light,
        });
    })?;
    let names = cameras.map(|camera| camera.name.as_str());
    let table = white_balance_table(names, readings.each_ref().map(Vec::as_slice)).map_err(ColorError::from)?;
    let told = Told {
        cameras,
        table,
        pictures,
        without_setting: without_setting.len(),
        scale: if settings.is_some() {
            "setting"
        } else {
            "gain of red over blue"
        },
    };
    task.args.output.write_json(&Numbers::new(&told))?;
    task.args.output.write_report(|| page(&told))?;
    write_summary(out, &told).map_err(CommandError::Output)
}

fn read_settings(file: &Path) -> Result<Settings, ColorError> {
    let table = Table::read(file)?;
    (0..table.len())
        .map(|line| {
            let [setting] = table.numbers(line, ["setting"])?;
            let key = (table.cell(line, "camera")?.to_owned(), table.whole(line, "frame")?);
            Ok((key, setting))
        })
        .collect()
}

/// The numbers as JSON.
#[derive(Serialize)]
struct Numbers {
    routine: &'static str,
    cameras: [String; 2],
    pictures: [usize; 2],
    pictures_without_setting: usize,
    scale: &'static str,
    patches: Vec<String>,
    white_balance: Vec<RowNumbers>,
    greys: [Vec<GreyNumbers>; 2],
}

#[derive(Serialize)]
struct RowNumbers {
    first_setting: f64,
    second_setting: f64,
    second_setting_sigma: f64,
    second_gains: [f64; 3],
    left_r_over_g: f64,
    left_b_over_g: f64,
    delta_e00: f64,
    is_at_end: bool,
}

#[derive(Serialize)]
struct GreyNumbers {
    setting: f64,
    gains: [f64; 3],
    r_over_g: f64,
    b_over_g: f64,
    sigma_r_over_g: f64,
    sigma_b_over_g: f64,
}

impl From<&Agreement> for RowNumbers {
    fn from(row: &Agreement) -> Self {
        Self {
            first_setting: row.first_setting,
            second_setting: row.second_setting,
            second_setting_sigma: row.sigma,
            second_gains: row.second_gains,
            left_r_over_g: row.left[0],
            left_b_over_g: row.left[1],
            delta_e00: row.delta_e,
            is_at_end: row.is_at_end,
        }
    }
}

impl From<&GreyAt> for GreyNumbers {
    fn from(grey: &GreyAt) -> Self {
        let (r, b) = (grey.chromaticity.x.exp(), grey.chromaticity.y.exp());
        Self {
            setting: grey.setting,
            gains: grey.gains,
            r_over_g: r,
            b_over_g: b,
            sigma_r_over_g: r * grey.covariance.x_axis.x.sqrt(),
            sigma_b_over_g: b * grey.covariance.y_axis.y.sqrt(),
        }
    }
}

impl Numbers {
    fn new(told: &Told<'_>) -> Self {
        let table = &told.table;
        Self {
            routine: "color",
            cameras: told.cameras.map(|camera| camera.name.clone()),
            pictures: told.pictures,
            pictures_without_setting: told.without_setting,
            scale: told.scale,
            patches: table.patches.clone(),
            white_balance: table.rows.iter().map(RowNumbers::from).collect(),
            greys: table
                .greys
                .each_ref()
                .map(|greys| greys.iter().map(GreyNumbers::from).collect()),
        }
    }
}

/// Head and cells of the table.
fn cells(told: &Told<'_>) -> (Vec<String>, Vec<Vec<String>>) {
    let [first, second] = told.cameras.map(|camera| &camera.name);
    let head = vec![
        first.clone(),
        second.clone(),
        "±".to_owned(),
        "r/g %".to_owned(),
        "b/g %".to_owned(),
        "ΔE00".to_owned(),
        String::new(),
    ];
    let row = |row: &Agreement| {
        let remark = if row.is_at_end {
            "at the end of the range"
        } else if row.delta_e > VISIBLE {
            "no setting agrees"
        } else {
            ""
        };
        vec![
            number(row.first_setting),
            number(row.second_setting),
            number(row.sigma),
            format!("{:+.2}", 100.0 * row.left[0]),
            format!("{:+.2}", 100.0 * row.left[1]),
            format!("{:.2}", row.delta_e),
            remark.to_owned(),
        ]
    };
    (head, told.table.rows.iter().map(row).collect())
}

/// Kelvin without, small numbers with three decimals.
fn number(value: f64) -> String {
    if !value.is_finite() {
        "–".to_owned()
    } else if value.abs() >= 100.0 {
        format!("{value:.0}")
    } else {
        format!("{value:.3}")
    }
}

fn write_summary(out: &mut impl Write, told: &Told<'_>) -> io::Result<()> {
    let [first, second] = told.cameras.map(|camera| &camera.name);
    let patches = told.table.patches.join("`, `");
    writeln!(
        out,
        "{} of `{second}` at which it shows grey as `{first}` does (by `{patches}`)",
        told.scale
    )?;
    let (head, rows) = cells(told);
    for line in std::iter::once(&head).chain(&rows) {
        let text: Vec<String> = line.iter().map(|cell| format!("{cell:>10}")).collect();
        writeln!(out, "{}", text.join(" ").trim_end())?;
    }
    if told.without_setting > 0 {
        writeln!(out, "{} pictures without a setting were left out", told.without_setting)?;
    }
    Ok(())
}

fn page(told: &Told<'_>) -> Report {
    let [first, second] = told.cameras.map(|camera| &camera.name);
    let mut report = Report::new(format!("White balance of camera {second}, matched to camera {first}"));
    if told.table.rows.iter().any(|row| row.is_at_end) {
        report.push(Block::Warning(format!(
            "For some settings of {first} the best of {second} is the lowest or highest recorded: record further ones."
        )));
    }
    let (head, rows) = cells(told);
    report.push(Block::Table {
        caption: format!(
            "{}: the best of {second} for each of {first}, and what is left",
            told.scale
        ),
        head,
        rows,
    });
    let [first_line, second_line] = told.table.greys.each_ref().map(|greys| {
        let point = |grey: &GreyAt| [grey.chromaticity.x.exp(), grey.chromaticity.y.exp()];
        greys.iter().map(point).collect::<Vec<_>>()
    });
    let series = |name: &str, points: &[[f64; 2]]| {
        [Style::Line, Style::Dots].map(|style| Series {
            name: name.to_owned(),
            points: points.to_vec(),
            style,
        })
    };
    report.push(Block::Plot {
        caption: "Grey at every setting. Where the lines meet, the cameras can agree wholly.".to_owned(),
        plot: Plot::Chart {
            x: Axis::linear("r/g"),
            y: Axis::linear("b/g"),
            series: [series(first, &first_line), series(second, &second_line)].concat(),
        },
    });
    let rows = told.table.rows.iter();
    let best: Vec<[f64; 2]> = rows.map(|row| [row.first_setting, row.second_setting]).collect();
    report.push(Block::Plot {
        caption: "The table as a curve.".to_owned(),
        plot: Plot::Chart {
            x: Axis::linear(format!("{} of {first}", told.scale)),
            y: Axis::linear(format!("{} of {second}", told.scale)),
            series: series("best", &best).to_vec(),
        },
    });
    report
}
