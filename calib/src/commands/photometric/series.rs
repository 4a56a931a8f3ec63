//! The pictures of a bracket and the exposure of each: from the recording, a list, or EXIF data.

use std::{
    borrow::Cow,
    collections::HashMap,
    fs,
    io::BufReader,
    path::{Path, PathBuf},
};

use exif::{In, Tag, Value};
use serde::{Deserialize, de::DeserializeOwned};

use super::{Args, PhotometricError};
use crate::commands::{
    CommandError,
    input::{Picture, Pictures},
    mask,
};

/// Memory that the pictures of a series may take, in bytes: 28 of 50 megapixels, 690 of 1920 × 1080.
const MAX_BYTES: u64 = 4 << 30;

/// Share of a picture that may be at one end of the scale.
const MAX_CLIPPED: f64 = 0.98;

/// Relative difference up to which two exposures are one setting.
const SAME_SETTING: f64 = 1e-3;

/// Pictures of one scene by one camera.
pub(super) struct Series {
    pub(super) names: Vec<String>,
    pub(super) codes: Vec<Vec<u8>>,
    /// Of each picture, the pixels that show nothing; empty when every pixel shows something.
    pub(super) holes: Vec<Vec<bool>>,
    pub(super) size_px: [u32; 2],
    /// Numbers of the frames; their place in the series where there are none.
    pub(super) frames: Vec<u64>,
    /// Index into `settings` of each picture.
    pub(super) setting_of: Vec<usize>,
    pub(super) settings: Vec<Setting>,
    pub(super) white_balance: [f64; 3],
    /// Files of the list of exposures that are not among the pictures, sorted.
    pub(super) unused: Vec<String>,
}

/// A setting of the driver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Setting {
    pub(super) exposure_s: f64,
    pub(super) gain: f64,
}

impl Setting {
    /// What the signal is in proportion to.
    pub(super) fn product_s(self) -> f64 {
        self.exposure_s * self.gain
    }

    fn is(self, other: Self) -> bool {
        let same = |a: f64, b: f64| (a / b - 1.0).abs() < SAME_SETTING;
        same(self.exposure_s, other.exposure_s) && same(self.gain, other.gain)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ExposureLine {
    file: String,
    exposure_s: f64,
    #[serde(default = "one")]
    gain: f64,
}

/// A request for another exposure.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RequestLine {
    pub(super) frame: u64,
    pub(super) exposure_s: f64,
    #[serde(default = "one")]
    pub(super) gain: f64,
}

fn one() -> f64 {
    1.0
}

/// Reads the series and checks that every picture shows something.
pub(super) fn read(args: &Args) -> Result<Series, CommandError> {
    let listed = args.exposures.as_deref().map(read_exposures).transpose()?;
    let mut series = Series {
        names: Vec::new(),
        codes: Vec::new(),
        holes: Vec::new(),
        size_px: [0, 0],
        frames: Vec::new(),
        setting_of: Vec::new(),
        settings: Vec::new(),
        white_balance: [1.0; 3],
        unused: Vec::new(),
    };
    for (index, picture) in args.input.open()?.enumerate() {
        let picture = picture?;
        if picture.camera.as_ref().is_some_and(|camera| *camera != args.camera) {
            continue;
        }
        let setting = match (&picture.exposure, &listed, &args.exposures) {
            (_, Some(listed), Some(file)) => *listed.get(&picture.name).ok_or_else(|| PhotometricError::Unlisted {
                picture: picture.name.clone(),
                file: file.clone(),
            })?,
            (Some(exposure), _, _) => Setting {
                exposure_s: exposure.time_s,
                gain: exposure.gain,
            },
            (None, _, _) => from_exif(&picture.name, args.input.images.as_deref())?,
        };
        series.add(picture, setting, index as u64, args.mask_rgb)?;
    }
    if series.names.is_empty() {
        return Err(PhotometricError::NoPictures {
            camera: args.camera.clone(),
        }
        .into());
    }
    let listed = listed.into_iter().flatten().map(|(file, _)| file);
    series.unused = listed.filter(|file| !series.names.contains(file)).collect();
    series.unused.sort();
    Ok(series)
}

impl Series {
    fn add(
        &mut self,
        picture: Picture,
        setting: Setting,
        index: u64,
        mask_rgb: Option<[u8; 3]>,
    ) -> Result<(), PhotometricError> {
        let found = [picture.rgb.width(), picture.rgb.height()];
        let white_balance = picture.exposure.map_or([1.0; 3], |exposure| exposure.white_balance);
        if self.names.is_empty() {
            self.size_px = found;
            self.white_balance = white_balance;
        }
        if found != self.size_px {
            return Err(PhotometricError::Size {
                picture: picture.name,
                found,
                expected: self.size_px,
            });
        }
        if white_balance != self.white_balance {
            return Err(PhotometricError::WhiteBalance { picture: picture.name });
        }
        check_memory(self.names.len(), found)?;
        let codes = picture.rgb.into_raw();
        let holes = mask_rgb.map(|color| mask::holes(&codes, found.map(|side| side as usize), color));
        let seen = outside(&codes, holes.as_slice());
        check_not_clipped(&picture.name, &seen)?;
        let known = self.settings.iter().position(|other| other.is(setting));
        self.setting_of.push(known.unwrap_or(self.settings.len()));
        if known.is_none() {
            self.settings.push(setting);
        }
        self.frames.push(picture.sequence.unwrap_or(index));
        self.names.push(picture.name);
        self.codes.push(codes);
        self.holes.extend(holes);
        Ok(())
    }

    /// The pixels of a picture that show nothing, if any do.
    pub(super) fn holes_of(&self, picture: usize) -> Option<&[bool]> {
        self.holes.get(picture).map(Vec::as_slice)
    }

    /// Codes of these pictures where none of them has a hole.
    pub(super) fn seen(&self, pictures: &[usize]) -> Vec<Cow<'_, [u8]>> {
        let holes: Vec<&[bool]> = pictures.iter().filter_map(|&picture| self.holes_of(picture)).collect();
        pictures
            .iter()
            .map(|&picture| outside(&self.codes[picture], &holes))
            .collect()
    }

    /// Indices of the pictures of a setting.
    pub(super) fn pictures_of(&self, setting: usize) -> impl Iterator<Item = usize> {
        (0..self.names.len()).filter(move |&picture| self.setting_of[picture] == setting)
    }
}

/// Codes of the pixels that are in none of these holes.
fn outside<'a>(codes: &'a [u8], holes: &[impl AsRef<[bool]>]) -> Cow<'a, [u8]> {
    if holes.is_empty() {
        return Cow::Borrowed(codes);
    }
    let is_seen = |pixel: usize| !holes.iter().any(|holes| holes.as_ref()[pixel]);
    let pixels = codes.chunks_exact(3).enumerate();
    Cow::Owned(
        pixels
            .filter(|(pixel, _)| is_seen(*pixel))
            .flat_map(|(_, codes)| codes)
            .copied()
            .collect(),
    )
}

/// Whether there is room for one picture more of this size.
fn check_memory(kept: usize, size_px: [u32; 2]) -> Result<(), PhotometricError> {
    let bytes = 3 * u64::from(size_px[0]) * u64::from(size_px[1]);
    if (kept as u64 + 1) * bytes <= MAX_BYTES {
        return Ok(());
    }
    Err(PhotometricError::TooMany {
        size_px,
        most: MAX_BYTES / bytes,
    })
}

fn check_not_clipped(picture: &str, codes: &[u8]) -> Result<(), PhotometricError> {
    let share = |end: u8| codes.iter().filter(|&&code| code == end).count() as f64 / codes.len().max(1) as f64;
    let (white, black) = (share(255), share(0));
    if white > MAX_CLIPPED {
        return Err(PhotometricError::Saturated {
            picture: picture.to_owned(),
            percent: 100.0 * white,
        });
    }
    if black > MAX_CLIPPED {
        return Err(PhotometricError::Black {
            picture: picture.to_owned(),
            percent: 100.0 * black,
        });
    }
    Ok(())
}

fn read_exposures(file: &Path) -> Result<HashMap<String, Setting>, PhotometricError> {
    let lines: Vec<ExposureLine> = read_csv(file)?;
    let mut settings = HashMap::new();
    for (line, index) in lines.into_iter().zip(2..) {
        let is_usable = |value: f64| value > 0.0 && value.is_finite();
        if !(is_usable(line.exposure_s) && is_usable(line.gain)) {
            return Err(PhotometricError::Csv {
                file: file.to_owned(),
                line: index,
                message: format!(
                    "exposure `{}` s at gain `{}` (allowed: both above 0)",
                    line.exposure_s, line.gain
                ),
            });
        }
        let setting = Setting {
            exposure_s: line.exposure_s,
            gain: line.gain,
        };
        settings.insert(line.file, setting);
    }
    Ok(settings)
}

/// Reads a table with a head.
pub(super) fn read_csv<T: DeserializeOwned>(file: &Path) -> Result<Vec<T>, PhotometricError> {
    let text = fs::read(file).map_err(|source| PhotometricError::Read {
        file: file.to_owned(),
        source,
    })?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_slice());
    reader
        .deserialize()
        .map(|line| {
            line.map_err(|error: csv::Error| PhotometricError::Csv {
                file: file.to_owned(),
                line: error.position().map_or(1, csv::Position::line),
                message: error.to_string(),
            })
        })
        .collect()
}

/// Exposure time and speed as the camera wrote them; a wider aperture counts as a longer time. Gain 1 is ISO 100, aperture 1 is
/// where times stay as they are.
fn from_exif(picture: &str, folder: Option<&Path>) -> Result<Setting, PhotometricError> {
    let missing = |missing| PhotometricError::ExifMissing {
        picture: picture.to_owned(),
        missing,
    };
    let file = folder.map_or_else(|| PathBuf::from(picture), |folder| folder.join(picture));
    let opened = fs::File::open(&file).map_err(|source| PhotometricError::Read { file, source })?;
    let exif = exif::Reader::new()
        .read_from_container(&mut BufReader::new(opened))
        .map_err(|_| missing("block"))?;
    let rational = |tag: Tag| match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64).filter(|&value| value > 0.0),
        _ => None,
    };
    let exposure_s = rational(Tag::ExposureTime).ok_or_else(|| missing("exposure time"))?;
    let iso = exif
        .get_field(Tag::PhotographicSensitivity, In::PRIMARY)
        .and_then(|field| field.value.get_uint(0));
    let aperture = rational(Tag::FNumber).unwrap_or(1.0);
    Ok(Setting {
        exposure_s: exposure_s / (aperture * aperture),
        gain: iso.filter(|&iso| iso > 0).map_or(1.0, |iso| f64::from(iso) / 100.0),
    })
}

/// The pictures of a folder, of one size.
pub(super) fn read_folder(folder: &Path, size_px: [u32; 2]) -> Result<Vec<(String, Vec<u8>)>, CommandError> {
    let mut pictures = Vec::new();
    for picture in Pictures::of_folder(folder)? {
        let picture = picture?;
        let found = [picture.rgb.width(), picture.rgb.height()];
        // There are several folders, and files of one name in them.
        let name = folder.join(&picture.name).display().to_string();
        if found != size_px {
            return Err(PhotometricError::Size {
                picture: name,
                found,
                expected: size_px,
            }
            .into());
        }
        check_memory(pictures.len(), size_px)?;
        pictures.push((name, picture.rgb.into_raw()));
    }
    Ok(pictures)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_that_would_fill_the_memory_is_refused_with_what_fits() {
        check_memory(689, [1920, 1080]).unwrap();
        let error = check_memory(690, [1920, 1080]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "there are more than `690` pictures of `1920 x 1080`, for which 4 GiB of memory are too little (allowed: 1 to 690)"
        );
        assert!(check_memory(0, [60_000, 60_000]).is_err());
    }

    #[test]
    fn a_hole_in_one_picture_is_left_out_of_all() {
        let codes = [1, 1, 1, 2, 2, 2, 3, 3, 3];
        assert_eq!(
            *outside(&codes, &[[true, false, false], [false, false, true]]),
            [2, 2, 2]
        );
        assert!(matches!(outside(&codes, &[] as &[Vec<bool>]), Cow::Borrowed(all) if all == codes));
    }
}
