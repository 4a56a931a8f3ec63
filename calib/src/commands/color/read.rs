//! The patches in the pictures of both cameras.

use std::collections::{BTreeMap, BTreeSet};

use mirrorball_calib::{
    color::{
        matching::SharedPatch,
        patches::PatchSheet,
        sample::{PatchLight, PatchPicture, SheetPlacing, sample},
    },
    resection,
    rig::{Camera, Rig},
    tag::Finder,
};

use super::{Args, ColorError};
use crate::commands::{
    CommandError, families,
    input::{Picture, Pictures},
};

/// Patches that a message names per reason.
const NAMED: usize = 6;

/// What both cameras see.
pub(super) struct Found {
    pub(super) shared: Vec<SharedPatch>,
    /// Camera, patch and reason of what was not used.
    pub(super) left_out: BTreeSet<(String, String, String)>,
    /// Pictures used of each camera.
    pub(super) pictures: [usize; 2],
}

impl Found {
    /// In words: per camera and reason the first few patches, and how many more.
    pub(super) fn left_out_text(&self) -> String {
        let mut groups: BTreeMap<(&str, &str), Vec<&str>> = BTreeMap::new();
        for (camera, patch, reason) in &self.left_out {
            groups.entry((camera, reason)).or_default().push(patch);
        }
        let text = |((camera, reason), patches): ((&str, &str), Vec<&str>)| {
            let named: Vec<String> = patches.iter().take(NAMED).map(|patch| format!("`{patch}`")).collect();
            let more = match patches.len().saturating_sub(NAMED) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            format!("{}{more} in `{camera}`: {reason}", named.join(", "))
        };
        let texts: Vec<String> = groups.into_iter().map(text).collect();
        if texts.is_empty() {
            "nothing".to_owned()
        } else {
            texts.join("; ")
        }
    }
}

/// One camera's patches over its pictures.
struct Seen {
    /// Patch and reason of what was not used.
    left_out: BTreeSet<(String, String)>,
    lights: Vec<Vec<PatchLight>>,
    pictures: usize,
    placed: usize,
}

pub(super) fn read(args: &Args, rig: &Rig, sheet: &PatchSheet, cameras: [&Camera; 2]) -> Result<Found, CommandError> {
    let mut seen = [(); 2].map(|()| Seen {
        left_out: BTreeSet::new(),
        lights: vec![Vec::new(); sheet.patches.len()],
        pictures: 0,
        placed: 0,
    });
    let mut finder = Finder::new(&families(rig));
    for picture in Pictures::of_recording(&args.recording)? {
        let picture = picture?;
        let Some(index) = cameras
            .iter()
            .position(|camera| picture.camera.as_ref() == Some(&camera.name))
        else {
            continue;
        };
        seen[index].pictures += 1;
        let Some(placing) = by_hand(args, sheet, cameras[index])?.map_or_else(
            || by_markers(rig, sheet, cameras[index], &picture, &mut finder),
            |placing| Ok(Some(placing)),
        )?
        else {
            continue;
        };
        seen[index].placed += 1;
        read_picture(sheet, cameras[index], &picture, &placing, &mut seen[index])?;
    }
    for (camera, seen) in cameras.iter().zip(&seen) {
        let camera = camera.name.clone();
        if seen.pictures == 0 {
            return Err(ColorError::NoPictures { camera }.into());
        }
        if seen.placed == 0 {
            let pictures = seen.pictures;
            return Err(ColorError::NotPlaced { camera, pictures }.into());
        }
    }
    let patches = sheet.patches.iter().enumerate();
    let shared = patches.filter_map(|(index, patch)| {
        let [first, second] = seen.each_ref().map(|seen| mean(&seen.lights[index]));
        let ((first, first_sigma), (second, second_sigma)) = (first?, second?);
        Some(SharedPatch {
            name: patch.name.clone(),
            first,
            second,
            // The second one's in the first one's unit.
            sigma: std::array::from_fn(|c| first_sigma[c].hypot(second_sigma[c] * first[c] / second[c].max(1e-12))),
            reference: patch.reference,
        })
    });
    let left_out = cameras.iter().zip(&seen).flat_map(|(camera, seen)| {
        let of = seen.left_out.iter();
        of.map(|(patch, reason)| (camera.name.clone(), patch.clone(), reason.clone()))
    });
    Ok(Found {
        shared: shared.collect(),
        left_out: left_out.collect(),
        pictures: seen.each_ref().map(|seen| seen.placed),
    })
}

/// Where the corners given on the command line put the sheet; `None` when there are none for this camera.
fn by_hand(args: &Args, sheet: &PatchSheet, camera: &Camera) -> Result<Option<SheetPlacing>, ColorError> {
    let Some(given) = args.chart_corners.iter().find(|given| given.camera == camera.name) else {
        return Ok(None);
    };
    let corners_m = sheet.corners_m.ok_or(ColorError::NoCorners)?;
    let placing = SheetPlacing::from_corners(&corners_m, &given.pixels, &camera.intrinsics);
    placing.map(Some).ok_or_else(|| ColorError::Corners {
        name: camera.name.clone(),
    })
}

/// Where the markers, or else the rig, put the sheet; `None` when neither tells.
fn by_markers(
    rig: &Rig,
    sheet: &PatchSheet,
    camera: &Camera,
    picture: &Picture,
    finder: &mut Finder,
) -> Result<Option<SheetPlacing>, CommandError> {
    let size = [picture.rgb.width() as usize, picture.rgb.height() as usize];
    let detections = finder
        .find(picture.rgb.as_raw(), size, camera)
        .map_err(|source| CommandError::Search {
            name: picture.name.clone(),
            source,
        })?;
    let located = resection::locate(&detections, rig, &camera.intrinsics).map(|located| located.camera_from_world);
    let Some(camera_from_world) = located.ok().or(camera.camera_from_world) else {
        return Ok(None);
    };
    let camera_from_sheet = match sheet.marker {
        Some(id) => camera_from_world * rig.marker(id).ok_or(ColorError::NoMarker { id })?.world_from_marker,
        None => camera_from_world,
    };
    Ok(Some(SheetPlacing::from_pose(&camera_from_sheet)))
}

fn read_picture(
    sheet: &PatchSheet,
    camera: &Camera,
    picture: &Picture,
    placing: &SheetPlacing,
    seen: &mut Seen,
) -> Result<(), ColorError> {
    let [width, height] = camera.intrinsics.size_px;
    let expected = 3 * width as usize * height as usize;
    let codes = picture.rgb.as_raw();
    if codes.len() != expected {
        return Err(ColorError::Size {
            picture: picture.name.clone(),
            found: codes.len(),
            expected,
        });
    }
    let Some(exposure) = &picture.exposure else {
        return Ok(());
    };
    let patch_picture = PatchPicture {
        codes,
        intrinsics: &camera.intrinsics,
        photometry: &camera.photometry,
        exposure,
    };
    for (patch, lights) in sheet.patches.iter().zip(&mut seen.lights) {
        match sample(&patch_picture, patch, placing) {
            Ok(light) => lights.push(light),
            Err(reason) => {
                seen.left_out.insert((patch.name.clone(), reason.to_string()));
            }
        }
    }
    Ok(())
}

/// Mean over the pictures, and its standard deviation.
fn mean(lights: &[PatchLight]) -> Option<([f64; 3], [f64; 3])> {
    if lights.is_empty() {
        return None;
    }
    let n = lights.len() as f64;
    let mean: [f64; 3] = std::array::from_fn(|c| lights.iter().map(|light| light.radiance[c]).sum::<f64>() / n);
    let sigma = std::array::from_fn(|c| {
        let spread: f64 = lights.iter().map(|light| (light.radiance[c] - mean[c]).powi(2)).sum();
        let own: f64 = lights.iter().map(|light| light.sigma[c].powi(2)).sum();
        ((spread + own) / n / n).sqrt()
    });
    Some((mean, sigma))
}
