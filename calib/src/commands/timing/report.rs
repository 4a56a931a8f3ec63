//! The page about times.

use mirrorball_calib::report::{
    Block, Plot, Report,
    plot::{Axis, Series, Style},
};

use super::{Found, Outcome, Signals};

/// Seconds of the signals that are drawn: enough to see changes.
const SHOWN_S: f64 = 4.0;

/// The page.
pub(super) fn report(found: &Found) -> Report {
    let mut report = Report::new("Timing");
    let shift_s = match &found.outcome {
        Outcome::Clocks(clocks) => clocks.offset_s,
        Outcome::Latency(latency) => latency.mean_s,
    };
    report.push(result(found));
    for (caption, shift_s) in [
        ("As stamped", 0.0),
        (
            "The second signal moved by the offset: the two must change together",
            shift_s,
        ),
    ] {
        report.push(signals(found, caption, shift_s));
    }
    if let Outcome::Latency(latency) = &found.outcome {
        report.push(Block::Plot {
            caption: "Latency of each change".to_owned(),
            plot: Plot::Chart {
                x: Axis::linear("time of the event, s"),
                y: Axis::linear("latency, ms"),
                series: vec![Series {
                    name: "latency".to_owned(),
                    points: latency.each_s.iter().map(|each| [each[0], 1e3 * each[1]]).collect(),
                    style: Style::Dots,
                }],
            },
        });
    }
    report
}

fn result(found: &Found) -> Block {
    let row = |name: &str, value: String, sigma: String| vec![name.to_owned(), value, sigma];
    let rows = match &found.outcome {
        Outcome::Clocks(clocks) => vec![
            row(
                &format!("offset, {} minus {}, ms", found.names[1], found.names[0]),
                format!("{:+.3}", 1e3 * clocks.offset_s),
                format!("{:.3}", 1e3 * clocks.offset_sigma_s),
            ),
            row(
                "drift, ppm",
                format!("{:+.1}", 1e6 * clocks.drift),
                format!("{:.1}", 1e6 * clocks.drift_sigma),
            ),
            row("compared", clocks.n_used.to_string(), String::new()),
        ],
        Outcome::Latency(latency) => vec![
            row(
                "mean latency, ms",
                format!("{:.2}", 1e3 * latency.mean_s),
                format!("{:.2}", 1e3 * latency.mean_sigma_s),
            ),
            row(
                "spread of single ones, ms",
                format!("{:.2}", 1e3 * latency.spread_s),
                String::new(),
            ),
            row("compared", latency.each_s.len().to_string(), String::new()),
        ],
    };
    Block::Table {
        caption: "Offset is the second clock's time minus the first one's, for one event".to_owned(),
        head: ["", "value", "standard deviation"].map(str::to_owned).to_vec(),
        rows,
    }
}

fn signals(found: &Found, caption: &str, shift_s: f64) -> Block {
    let points: [Vec<[f64; 2]>; 2] = match &found.signals {
        Signals::Light(light) => light.each_ref().map(|samples| {
            samples
                .iter()
                .map(|s| [s.start_s + 0.5 * s.exposure_s, s.value])
                .collect()
        }),
        Signals::Path(paths) => paths
            .each_ref()
            .map(|path| path.iter().map(|s| [s.middle_s, s.place_px[0]]).collect()),
    };
    let from_s = points[0].first().map_or(0.0, |point| point[0]);
    let series = points
        .into_iter()
        .zip(&found.names)
        .zip([0.0, shift_s])
        .map(|((points, name), shift_s)| {
            let least = points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
            let most = points.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
            let moved = points
                .into_iter()
                .map(|[t, v]| [t - shift_s, (v - least) / (most - least)]);
            Series {
                name: name.clone(),
                points: moved.filter(|[t, _]| (0.0..SHOWN_S).contains(&(t - from_s))).collect(),
                style: Style::Line,
            }
        });
    Block::Plot {
        caption: caption.to_owned(),
        plot: Plot::Chart {
            x: Axis::linear("time, s"),
            y: Axis::linear("signal, of its range"),
            series: series.collect(),
        },
    }
}
