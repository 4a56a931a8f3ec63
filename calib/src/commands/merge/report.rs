//! The figures that `merge` prints.

use std::io::{self, Write};

use mirrorball_calib::{
    merge::{State, stack::MergedPicture},
    probe::radiance::luminance,
    response_fit::RatioErrors,
};
use serde::Serialize;

use super::{Response, Series};

/// Exposure-ratio error of a shared curve from which on a curve per channel is recommended.
const MAX_SHARED_ERROR: f64 = 0.02;

/// What `--json` prints; its keys are an interface.
#[derive(Serialize)]
pub(super) struct Report {
    pictures: Vec<PictureEntry>,
    response: ResponseEntry,
    merged: MergedEntry,
}

#[derive(Serialize)]
struct PictureEntry {
    file: String,
    exposure_s: f64,
    /// What the exposure time was corrected by, EV; 0 where it was not.
    correction_ev: f64,
    clipped: f64,
    black: f64,
    /// Share of the merged pixels in which this picture weighs most.
    main: f64,
}

#[derive(Serialize)]
struct ResponseEntry {
    source: String,
    /// Smallest and largest code that the pictures tell about.
    known_codes: Option<[u8; 2]>,
    exposure_ratio: Option<RatioEntry>,
    /// The same with the response that Debevec and Malik's method finds and the exposure times as given, to compare with.
    exposure_ratio_debevec_malik: Option<RatioEntry>,
}

#[derive(Serialize)]
struct RatioEntry {
    patch_median: f64,
    pair_median: f64,
    worst: f64,
    worst_pictures: [usize; 2],
    worst_channel: &'static str,
    pairs: usize,
    patches: usize,
}

#[derive(Serialize)]
struct MergedEntry {
    reference: usize,
    measured: f64,
    clipped: f64,
    black: f64,
    moved: f64,
    unseen: f64,
    /// Ratio of the 0.1 % brightest to the 0.1 % darkest luminance.
    dynamic_range: f64,
}

impl Report {
    pub(super) fn new(series: &Series, response: &Response, merged: &MergedPicture) -> Self {
        let pictures = (0..series.files.len()).map(|index| picture(index, series, response, merged));
        let ratio = |errors: &RatioErrors| RatioEntry {
            patch_median: errors.patch_median,
            pair_median: errors.pair_median,
            worst: errors.worst.error,
            worst_pictures: errors.worst.pictures,
            worst_channel: ["red", "green", "blue"][errors.worst.channel],
            pairs: errors.pairs,
            patches: errors.patches,
        };
        Self {
            pictures: pictures.collect(),
            response: ResponseEntry {
                source: response.source.clone(),
                known_codes: response.known_codes,
                exposure_ratio: response.errors.as_ref().map(ratio),
                exposure_ratio_debevec_malik: response.debevec_malik.as_ref().map(ratio),
            },
            merged: merged_entry(merged),
        }
    }

    pub(super) fn write_json(&self, out: &mut impl Write) -> io::Result<()> {
        serde_json::to_writer(&mut *out, self)?;
        writeln!(out)
    }

    /// Whether one curve does not explain the pictures.
    fn channels_differ(&self) -> bool {
        let ratio = self.response.exposure_ratio.as_ref();
        self.response.source == "fit" && ratio.is_some_and(|ratio| ratio.pair_median > MAX_SHARED_ERROR)
    }

    pub(super) fn write_table(&self, out: &mut impl Write) -> io::Result<()> {
        writeln!(out, "exposure s  corrected EV  clipped %  black %  main %  picture")?;
        for picture in &self.pictures {
            writeln!(
                out,
                "{:>10.6}  {:>12.3}  {:>9.2}  {:>7.2}  {:>6.1}  {}",
                picture.exposure_s,
                picture.correction_ev,
                100.0 * picture.clipped,
                100.0 * picture.black,
                100.0 * picture.main,
                picture.file
            )?;
        }
        write!(out, "response {}", self.response.source)?;
        if let Some([low, high]) = self.response.known_codes {
            write!(out, ", known from code {low} to {high}")?;
        }
        writeln!(out)?;
        match &self.response.exposure_ratio {
            Some(ratio) => writeln!(
                out,
                "exposure-ratio error: {:.2} % median over {} pairs and channels, worst {:.2} % ({}, pictures {} and {}), \
                 {:.2} % median over {} patches",
                100.0 * ratio.pair_median,
                ratio.pairs,
                100.0 * ratio.worst,
                ratio.worst_channel,
                ratio.worst_pictures[0],
                ratio.worst_pictures[1],
                100.0 * ratio.patch_median,
                ratio.patches
            )?,
            None => writeln!(out, "exposure-ratio error: no two pictures are well exposed in common")?,
        }
        if self.channels_differ() {
            writeln!(out, "the channels seem to differ: try `--response fit-channels`")?;
        }
        let merged = &self.merged;
        writeln!(
            out,
            "merged: {:.2} % measured, {:.2} % clipped, {:.2} % black, {:.2} % unseen; {:.2} % moved (picture {} rules); \
             dynamic range {:.0}:1; nothing was warped",
            100.0 * merged.measured,
            100.0 * merged.clipped,
            100.0 * merged.black,
            100.0 * merged.unseen,
            100.0 * merged.moved,
            merged.reference,
            merged.dynamic_range
        )
    }
}

fn picture(index: usize, series: &Series, response: &Response, merged: &MergedPicture) -> PictureEntry {
    let pixels = || series.codes[index].chunks_exact(3);
    let share = |n: usize| n as f64 / merged.origin.len().max(1) as f64;
    let is_hole = |pixel: usize| series.holes.as_ref().is_some_and(|holes| holes[index][pixel]);
    let count = |end: u8| {
        pixels()
            .enumerate()
            .filter(|(pixel, codes)| codes.contains(&end) && !is_hole(*pixel))
            .count()
    };
    let main = merged
        .origin
        .iter()
        .filter(|origin| origin.picture.map(usize::from) == Some(index))
        .count();
    PictureEntry {
        file: series.files[index].display().to_string(),
        exposure_s: series.exposures_s[index],
        correction_ev: response.exposures_s[index]
            .iter()
            .map(|time| (time / series.exposures_s[index]).log2())
            .sum::<f64>()
            / 3.0,
        clipped: share(count(255)),
        black: share(count(0)),
        main: share(main),
    }
}

fn merged_entry(merged: &MergedPicture) -> MergedEntry {
    let n = merged.origin.len().max(1) as f64;
    let share = |wanted: &dyn Fn(&[State; 3]) -> bool| {
        let count = merged
            .origin
            .iter()
            .filter(|origin| origin.picture.is_some() && wanted(&origin.states))
            .count();
        count as f64 / n
    };
    let mut luminances: Vec<f32> = merged
        .radiance
        .iter()
        .map(|&rgb| luminance(rgb.into()))
        .filter(|&luminance| luminance > 0.0)
        .collect();
    luminances.sort_by(f32::total_cmp);
    let at = |share: f64| {
        let index = (share * luminances.len() as f64) as usize;
        luminances.get(index.min(luminances.len().saturating_sub(1))).copied()
    };
    MergedEntry {
        reference: merged.reference,
        measured: share(&|states| states.iter().all(|&state| state == State::Measured)),
        clipped: share(&|states| states.contains(&State::AtLeast)),
        black: share(&|states| states.contains(&State::AtMost) && !states.contains(&State::AtLeast)),
        moved: merged.origin.iter().filter(|origin| origin.has_moved).count() as f64 / n,
        unseen: merged.origin.iter().filter(|origin| origin.picture.is_none()).count() as f64 / n,
        dynamic_range: f64::from(at(0.999).unwrap_or(1.0) / at(0.001).unwrap_or(1.0)),
    }
}
