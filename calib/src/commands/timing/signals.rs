//! Pictures of a recording to signals over time.

use std::collections::BTreeMap;

use image::RgbImage;
use mirrorball_calib::{
    response::ResponseCurve,
    rig::RigParts,
    tag::{Detection, Detector, Family, LumaView},
    timing::{
        Sample, Stamp, TimingError,
        blink::{BLOCK_PX, MAX_CLIPPED, blinking_blocks},
        motion::Sighting,
    },
};

use super::{Region, TimingCommandError};
use crate::commands::{
    CommandError,
    input::{InputArgs, Picture},
    own_rig,
};

/// Code from which a pixel counts as clipped, at the latest.
const CLIPPED_CODE: u8 = 254;

/// One camera's light while the recording goes by.
struct Light<'a> {
    camera: &'a str,
    region: Option<Region>,
    response: ResponseCurve,
    /// Start and length of each exposure, seconds.
    exposures: Vec<[f64; 2]>,
    /// Mean linear light of the region, or of every block.
    frames: Vec<Vec<f32>>,
    /// Largest share of clipped pixels that each had.
    clipped: Vec<f32>,
}

/// The light of two regions or cameras over time; times count from the recording's first frame. Codes are read by the response
/// that the recording's rig file gives for the camera, as sRGB where it gives none.
pub(super) fn light(
    input: &InputArgs,
    wanted: &[(&str, Option<Region>); 2],
    stamp: Stamp,
) -> Result<[Vec<Sample>; 2], CommandError> {
    let rig = input.recording.as_deref().map(own_rig).transpose()?.flatten();
    let mut lights = wanted.map(|(camera, region)| Light {
        camera,
        region,
        response: response(rig.as_ref().map(|(_, parts)| parts), camera),
        exposures: Vec::new(),
        frames: Vec::new(),
        clipped: Vec::new(),
    });
    let mut first_ns = None;
    for picture in input.open()? {
        let picture = picture?;
        let (camera, [start_s, exposure_s]) = when(&picture, &mut first_ns, stamp)?;
        for light in lights.iter_mut().filter(|light| light.camera == camera) {
            light.add(&picture.rgb)?;
            light.exposures.push([start_s, exposure_s]);
        }
    }
    let [a, b] = lights;
    Ok([a.samples()?, b.samples()?])
}

fn response(rig: Option<&RigParts>, camera: &str) -> ResponseCurve {
    let photometry = rig.and_then(|parts| parts.camera(camera)?.photometry.as_ref());
    photometry.map_or_else(ResponseCurve::srgb, |photometry| photometry.response.clone())
}

/// The camera of a picture, and start and length of its exposure, seconds since the first.
fn when<'a>(
    picture: &'a Picture,
    first_ns: &mut Option<u64>,
    stamp: Stamp,
) -> Result<(&'a str, [f64; 2]), TimingCommandError> {
    let (Some(camera), Some(time_ns), Some(exposure)) = (&picture.camera, picture.timestamp_ns, picture.exposure)
    else {
        return Err(TimingCommandError::NoTime);
    };
    let first_ns = *first_ns.get_or_insert(time_ns);
    let since_s = (i128::from(time_ns) - i128::from(first_ns)) as f64 * 1e-9;
    Ok((camera, [stamp.start_s(since_s, exposure.time_s), exposure.time_s]))
}

impl Light<'_> {
    fn add(&mut self, rgb: &RgbImage) -> Result<(), TimingCommandError> {
        let [width, height] = [rgb.width(), rgb.height()];
        let block = BLOCK_PX as u32;
        let regions: Vec<[u32; 4]> = match self.region {
            Some(Region(region)) => {
                let [x, y, w, h] = region;
                if x.saturating_add(w) > width || y.saturating_add(h) > height {
                    return Err(TimingCommandError::Region {
                        camera: self.camera.to_owned(),
                        region,
                        size: [width, height],
                    });
                }
                vec![region]
            }
            None => (0..height / block)
                .flat_map(|row| (0..width / block).map(move |column| [column * block, row * block, block, block]))
                .collect(),
        };
        self.clipped.resize(regions.len(), 0.0);
        let response = &self.response;
        let means = regions.into_iter().zip(&mut self.clipped).map(|(region, most)| {
            let (mean, clipped) = mean(rgb, region, response);
            *most = most.max(clipped);
            mean
        });
        self.frames.push(means.collect());
        Ok(())
    }

    fn samples(self) -> Result<Vec<Sample>, TimingCommandError> {
        let camera = self.camera.to_owned();
        if self.frames.is_empty() {
            return Err(TimingCommandError::NoPicture { camera });
        }
        let blocks = if self.region.is_none() {
            blinking_blocks(&self.frames, &self.clipped, self.camera)?
        } else if self.clipped[0] > MAX_CLIPPED {
            return Err(TimingError::Saturated { camera }.into());
        } else {
            vec![0]
        };
        let samples = self
            .frames
            .iter()
            .zip(&self.exposures)
            .map(|(frame, [start_s, exposure_s])| Sample {
                start_s: *start_s,
                exposure_s: *exposure_s,
                value: blocks.iter().map(|block| f64::from(frame[*block])).sum::<f64>() / blocks.len() as f64,
            });
        Ok(samples.collect())
    }
}

/// Mean linear light of a region, all channels alike, and the share of its pixels with a clipped channel.
fn mean(rgb: &RgbImage, [x, y, width, height]: [u32; 4], response: &ResponseCurve) -> (f32, f32) {
    let table = response.table();
    let clipped_code = response.first_clipped_code().min(CLIPPED_CODE);
    let (mut sum, mut n_clipped) = (0.0, 0u32);
    for row in y..y + height {
        for column in x..x + width {
            let codes = rgb.get_pixel(column, row).0;
            sum += codes.iter().map(|code| table[usize::from(*code)]).sum::<f32>();
            n_clipped += u32::from(codes.iter().any(|code| *code >= clipped_code));
        }
    }
    let n = (width * height) as f32;
    (sum / (3.0 * n), n_clipped as f32 / n)
}

/// The places of one marker in two cameras' pictures over time.
pub(super) fn paths(
    input: &InputArgs,
    names: &[String; 2],
    stamp: Stamp,
    marker: Option<u32>,
) -> Result<[Vec<Sighting>; 2], CommandError> {
    let mut detector = Detector::new(&Family::ALL);
    let mut seen: [BTreeMap<u32, Vec<Sighting>>; 2] = Default::default();
    let mut first_ns = None;
    for picture in input.open()? {
        let picture = picture?;
        let (camera, [start_s, exposure_s]) = when(&picture, &mut first_ns, stamp)?;
        let Some(index) = names.iter().position(|name| name == camera) else {
            continue;
        };
        let luma: Vec<u8> = image::imageops::grayscale(&picture.rgb).into_raw();
        let size = [picture.rgb.width() as usize, picture.rgb.height() as usize];
        let view = LumaView::new(size, size[0], &luma).map_err(|source| TimingCommandError::Search {
            picture: picture.name.clone(),
            source,
        })?;
        for detection in detector.detect(view) {
            seen[index]
                .entry(detection.id)
                .or_default()
                .push(sighting(&detection, start_s + 0.5 * exposure_s));
        }
    }
    let n_both = |id: &u32| seen[0][id].len().min(seen[1].get(id).map_or(0, Vec::len));
    let chosen = marker.or_else(|| seen[0].keys().copied().max_by_key(|id| n_both(id)));
    let chosen = chosen.filter(|id| seen.iter().all(|seen| seen.contains_key(id)));
    let id = chosen.ok_or(TimingCommandError::NoMarker)?;
    let [mut a, mut b] = seen;
    let take = |seen: &mut BTreeMap<u32, Vec<Sighting>>| seen.remove(&id).expect("both have seen it");
    Ok([take(&mut a), take(&mut b)])
}

fn sighting(detection: &Detection, middle_s: f64) -> Sighting {
    let sum = detection.corners_px.iter().sum::<glam::DVec2>();
    Sighting {
        middle_s,
        place_px: (sum / 4.0).to_array(),
        side_px: detection.mean_side_px(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_read_by_the_response_of_the_rig() {
        let text = include_str!("../../../tests/support/rig.toml");
        let steep: Vec<f64> = (0..256).map(|code| (f64::from(code) / 255.0).powi(3)).collect();
        let table = format!("response = {steep:?}");
        let text = text.replacen("response = \"srgb\"", &table, 1);
        let rig = RigParts::from_toml(&text, "rig.toml".as_ref()).unwrap();
        let grey = |camera| {
            let picture = RgbImage::from_pixel(8, 8, image::Rgb([128; 3]));
            mean(&picture, [0, 0, 8, 8], &response(Some(&rig), camera)).0
        };
        assert!((f64::from(grey("scene")) - (128.0f64 / 255.0).powi(3)).abs() < 1e-6);
        let srgb = ResponseCurve::srgb().table()[128];
        // The other camera's says so, and one that the rig does not know is taken to be.
        assert!((grey("probe") - srgb).abs() < 1e-6 && (grey("left") - srgb).abs() < 1e-6);
        assert_eq!(response(None, "scene"), ResponseCurve::srgb());
    }

    #[test]
    fn clipping_begins_where_the_response_ends() {
        let early: Vec<f64> = (0..256).map(|code| (f64::from(code) / 240.0).min(1.0)).collect();
        let early = ResponseCurve::from_table(&early).unwrap();
        let picture = RgbImage::from_fn(4, 1, |x, _| image::Rgb([if x == 0 { 241 } else { 100 }; 3]));
        assert_eq!(mean(&picture, [0, 0, 4, 1], &early).1, 0.25);
        assert_eq!(mean(&picture, [0, 0, 4, 1], &ResponseCurve::srgb()).1, 0.0);
    }
}
