//! How long after an event a display shows it, both seen by one camera.

use super::{TimingError, align, blink::Edge};

/// Latency from an event to its picture on a display.
#[derive(Debug, Clone, PartialEq)]
pub struct Latency {
    /// Mean, seconds.
    pub mean_s: f64,
    /// Standard deviation of the mean, seconds.
    pub mean_sigma_s: f64,
    /// Standard deviation of single latencies, seconds: camera, pipeline and display each wait for their next tick. What the
    /// filming camera's own exposures leave open is taken out.
    pub spread_s: f64,
    /// Shortest and longest, seconds, as far as the filming camera can tell.
    pub range_s: [f64; 2],
    /// Single latencies: time of the event and latency, seconds.
    pub each_s: Vec<[f64; 2]>,
}

/// Compares the edges of an event with those of its picture on a display, which comes 0 to `max_s` seconds later.
///
/// # Errors
/// [`TimingError::NoAgreement`], [`TimingError::Ambiguous`].
pub fn latency(event: &[Edge], display: &[Edge], max_s: f64) -> Result<Latency, TimingError> {
    /// How far a single latency may be from the common one, seconds: two frames at 30 Hz.
    const JITTER_S: f64 = 0.067;
    let (common_s, share) = align::coarse(event, display, [0.0, max_s])?;
    let pairs: Vec<(&Edge, &Edge)> = event
        .iter()
        .filter_map(|edge| Some((edge, align::partner(edge, display, common_s)?)))
        .filter(|(edge, other)| (other.middle_s() - edge.middle_s() - common_s).abs() < JITTER_S)
        .collect();
    if pairs.len() < super::MIN_EDGES {
        return Err(TimingError::NoAgreement { share });
    }
    let n = pairs.len() as f64;
    let each_s: Vec<[f64; 2]> = pairs
        .iter()
        .map(|(edge, other)| [edge.middle_s(), other.middle_s() - edge.middle_s()])
        .collect();
    let mean_s = each_s.iter().map(|each| each[1]).sum::<f64>() / n;
    let variance = each_s.iter().map(|each| (each[1] - mean_s).powi(2)).sum::<f64>() / (n - 1.0);
    // An instant evenly distributed over a span has a variance of its square over 12.
    let open = pairs
        .iter()
        .map(|(a, b)| (a.width_s().powi(2) + b.width_s().powi(2)) / 12.0 + a.sigma_s.powi(2) + b.sigma_s.powi(2))
        .sum::<f64>()
        / n;
    let bounds = each_s.iter().map(|each| each[1]);
    Ok(Latency {
        mean_s,
        mean_sigma_s: (variance.max(open) / n).sqrt(),
        spread_s: (variance - open).max(0.0).sqrt(),
        range_s: [
            bounds.clone().fold(f64::INFINITY, f64::min),
            bounds.fold(f64::NEG_INFINITY, f64::max),
        ],
        each_s,
    })
}
