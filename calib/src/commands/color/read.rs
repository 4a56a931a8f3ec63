//! The patches in the pictures of both cameras.

use std::collections::{BTreeMap, BTreeSet};

use mirrorball_calib::{
    color::{
        matching::SharedPatch,
        print::MARKER_FAMILY,
        sample::{PatchLight, PatchPicture, SheetPlacing, Unread, sample},
    },
    resection,
    rig::Camera,
    tag::Finder,
};
use mirrorball_capture::frame::Exposure;

use super::{ColorError, Task};
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
}

/// A patch in a picture.
pub(super) struct PatchSeen<'a> {
    /// Which of the two cameras.
    pub(super) camera: usize,
    /// Which patch of the sheet.
    pub(super) patch: usize,
    pub(super) picture: &'a Picture,
    pub(super) exposure: &'a Exposure,
    pub(super) light: Result<PatchLight, Unread>,
}

pub(super) fn read(task: &Task<'_>, cameras: [&Camera; 2]) -> Result<Found, CommandError> {
    let sheet = &task.sheet;
    let mut seen = [(); 2].map(|()| Seen {
        left_out: BTreeSet::new(),
        lights: vec![Vec::new(); sheet.patches.len()],
    });
    let pictures = visit(task, cameras, |found| {
        let seen = &mut seen[found.camera];
        match found.light {
            Ok(light) => seen.lights[found.patch].push(light),
            Err(reason) => {
                let name = sheet.patches[found.patch].name.clone();
                seen.left_out.insert((name, reason.to_string()));
            }
        }
    })?;
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
        pictures,
    })
}

/// Reads every patch in every picture of the two cameras; the number of pictures of each in which the sheet's place is known.
pub(super) fn visit(
    task: &Task<'_>,
    cameras: [&Camera; 2],
    mut take: impl FnMut(PatchSeen<'_>),
) -> Result<[usize; 2], CommandError> {
    let (mut pictures, mut placed) = ([0; 2], [0; 2]);
    let mut all = families(&task.rig);
    if task.sheet.marker_side_m.is_some() && !all.contains(&MARKER_FAMILY) {
        all.push(MARKER_FAMILY);
    }
    let mut finder = Finder::new(&all);
    for picture in Pictures::of_recording(task.recording)? {
        let picture = picture?;
        let Some(index) = cameras
            .iter()
            .position(|camera| picture.camera.as_ref() == Some(&camera.name))
        else {
            continue;
        };
        pictures[index] += 1;
        let Some(placing) = by_hand(task, cameras[index])?.map_or_else(
            || by_markers(task, cameras[index], &picture, &mut finder),
            |placing| Ok(Some(placing)),
        )?
        else {
            continue;
        };
        placed[index] += 1;
        read_picture(task, cameras[index], &picture, &placing, |patch, exposure, light| {
            take(PatchSeen {
                camera: index,
                patch,
                picture: &picture,
                exposure,
                light,
            });
        })?;
    }
    for (index, camera) in cameras.iter().enumerate() {
        let (camera, pictures) = (camera.name.clone(), pictures[index]);
        if pictures == 0 {
            return Err(ColorError::NoPictures { camera }.into());
        }
        if placed[index] == 0 {
            return Err(ColorError::NotPlaced { camera, pictures }.into());
        }
    }
    Ok(placed)
}

/// Where the corners given on the command line put the sheet; `None` when there are none for this camera.
fn by_hand(task: &Task<'_>, camera: &Camera) -> Result<Option<SheetPlacing>, ColorError> {
    let Some(given) = task.args.chart_corners.iter().find(|given| given.camera == camera.name) else {
        return Ok(None);
    };
    let corners_m = task.sheet.corners_m.ok_or(ColorError::NoCorners)?;
    let placing = SheetPlacing::from_corners(&corners_m, &given.pixels, &camera.intrinsics);
    placing.map(Some).ok_or_else(|| ColorError::Corners {
        name: camera.name.clone(),
    })
}

/// Where the sheet's own marker, or for a sheet without one the rig's markers or else the rig, put the sheet; `None` when none tells.
fn by_markers(
    task: &Task<'_>,
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
    let (rig, sheet) = (&task.rig, &task.sheet);
    if let Some(corners_m) = sheet.marker_corners_m() {
        let own = detections
            .iter()
            .find(|found| found.family == MARKER_FAMILY && Some(found.id) == sheet.marker);
        return Ok(own.and_then(|own| SheetPlacing::from_corners(&corners_m, &own.corners_px, &camera.intrinsics)));
    }
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

fn read_picture<'a>(
    task: &Task<'_>,
    camera: &Camera,
    picture: &'a Picture,
    placing: &SheetPlacing,
    mut take: impl FnMut(usize, &'a Exposure, Result<PatchLight, Unread>),
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
    for (index, patch) in task.sheet.patches.iter().enumerate() {
        take(index, exposure, sample(&patch_picture, patch, placing));
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
