//! Light of several sequences in one table.

use crate::{
    ToolError,
    environment_error::{EnvironmentError, FrameEnvironmentError},
    lamp_distance::{self, LampDistance},
    outputs::Outputs,
    score::Score,
    statistics::Spread,
    truth::Truth,
};
use std::path::Path;

/// Errors of the light of one sequence.
#[derive(Clone, Debug)]
pub struct SequenceLight {
    /// Name of the folder that holds the sequence.
    pub name: String,
    /// Errors of the maps, the probe's first.
    pub environments: Vec<EnvironmentError>,
    /// Errors of the distances of lamps.
    pub lamps: Vec<LampDistance>,
}

impl SequenceLight {
    /// Compares the output of a run with the truth of a sequence, a folder with `recording`, `scene` and `truth`.
    ///
    /// # Errors
    /// When a file of either is missing or broken.
    pub fn measure(sequence: &Path, output: &Path) -> Result<Self, ToolError> {
        let truth_folder = sequence.join("truth");
        Ok(Self {
            name: folder_name(sequence),
            environments: Score::measure_light(output, &truth_folder)?.environments,
            lamps: lamp_distance::measure(&Outputs::load(output)?, &Truth::load(&truth_folder)?),
        })
    }
}

/// Returns the last part of a folder's path.
pub fn folder_name(folder: &Path) -> String {
    folder
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Lays the table out for a terminal: figures are medians over frames unless it says worst.
pub fn text(sequences: &[SequenceLight]) -> String {
    let mut lines = vec![
        line(
            "",
            [
                "light",
                "light",
                "irradiance",
                "upper",
                "unclipped",
                "lamp at",
                "lamp at",
                "",
            ],
        ),
        line("", ["deg", "worst", "%", "%", "%", "off by %", "worst", "frames"]),
    ];
    for sequence in sequences {
        let lamps = Spread::of(sequence.lamps.iter().filter_map(|lamp| lamp.error_percent).collect());
        for place in &sequence.environments {
            let lamps = lamps.filter(|_| place.is_probe);
            let name = if place.is_probe {
                format!("{}, {}", sequence.name, place.at)
            } else {
                format!("    {}", place.at)
            };
            lines.push(place_line(&name, place, lamps));
        }
        lines.extend(lamp_note(&sequence.lamps));
    }
    lines.join("\n") + "\n"
}

fn place_line(name: &str, place: &EnvironmentError, lamps: Option<Spread>) -> String {
    let light = |frame: &FrameEnvironmentError| frame.light_deg;
    let cells = [
        number(place.median(light), 2),
        number(place.worst(light), 2),
        number(place.median(|frame| Some(frame.irradiance.mean_percent)), 1),
        number(place.median(|frame| Some(frame.irradiance.upper_mean_percent)), 1),
        number(place.median(|frame| frame.unclipped_percent), 1),
        number(lamps.map(|lamps| lamps.median), 1),
        number(lamps.map(|lamps| lamps.worst), 1),
        place.frames.len().to_string(),
    ];
    line(name, cells.each_ref().map(String::as_str))
}

/// What the numbers of a sequence's lamps leave out.
fn lamp_note(lamps: &[LampDistance]) -> Option<String> {
    let n_missed = lamps.iter().filter(|lamp| lamp.error_percent.is_none()).count();
    let n_assumed = lamps
        .iter()
        .filter(|lamp| lamp.error_percent.is_some() && !lamp.is_told)
        .count();
    (n_missed + n_assumed > 0).then(|| {
        format!(
            "    of {} sights of a lamp {n_missed} were not found, {n_assumed} have an assumed distance",
            lamps.len()
        )
    })
}

fn line(name: &str, cells: [&str; 8]) -> String {
    let cells: String = cells.iter().map(|cell| format!("{cell:>11}")).collect();
    format!("{name:<34}{cells}").trim_end().to_owned()
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sequence_has_a_line_per_place_and_says_what_is_missing() {
        let place = |at: &str, is_probe: bool| EnvironmentError {
            at: at.to_owned(),
            is_probe,
            true_light_radius_deg: None,
            frames: Vec::new(),
        };
        let lamp = |error_percent: Option<f64>| LampDistance {
            error_percent,
            is_told: true,
        };
        let text = text(&[SequenceLight {
            name: "room".to_owned(),
            environments: vec![place("ball", true), place("vase", false)],
            lamps: vec![lamp(Some(4.0)), lamp(None)],
        }]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 5);
        assert!(lines[2].starts_with("room, ball") && lines[2].contains("4.0"), "{text}");
        assert!(lines[3].starts_with("    vase") && !lines[3].contains("4.0"), "{text}");
        assert!(lines[4].contains("of 2 sights of a lamp 1 were not found"), "{text}");
    }
}
