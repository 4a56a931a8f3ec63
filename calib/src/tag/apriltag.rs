//! The one place that talks to AprilRobotics' C library (version 3.4.5).
#![expect(unsafe_code, reason = "the detector is a C library")]

use std::ptr::NonNull;

use apriltag_sys as ffi;
use glam::DVec2;

use super::{Detection, Family, LumaView};

/// Bits of a code that may be wrong and are corrected (the library's own default).
const CORRECTED_BITS: i32 = 2;

/// Offset of the library's pixel centres from ours, which are integers.
const PIXEL_CENTRE: f64 = 0.5;

/// A detector of the C library with its families. One thread, no decimation, so results are repeatable.
pub(super) struct Library {
    detector: NonNull<ffi::apriltag_detector_t>,
    families: Vec<(Family, NonNull<ffi::apriltag_family_t>)>,
}

// SAFETY: the library keeps no state outside the detector and its families, which this type owns alone, and with one
// thread it starts no worker whose identity could matter.
unsafe impl Send for Library {}

impl Library {
    pub(super) fn new(families: &[Family]) -> Self {
        // SAFETY: takes no argument; the result is checked and owned by `Self`, which frees it in `drop`.
        let detector = NonNull::new(unsafe { ffi::apriltag_detector_create() }).expect("no memory left for a detector");
        let mut library = Self {
            detector,
            families: Vec::with_capacity(families.len()),
        };
        // SAFETY: the detector was just created and nothing else refers to it.
        unsafe {
            let settings = library.detector.as_mut();
            settings.nthreads = 1;
            settings.quad_decimate = 1.0;
            settings.quad_sigma = 0.0;
            settings.refine_edges = true;
        }
        for &family in families {
            if library.families.iter().any(|(known, _)| *known == family) {
                continue;
            }
            // SAFETY: the family is new, is added to a live detector once, and outlives it: `drop` frees it afterwards.
            let table = unsafe {
                let table = match family {
                    Family::Tag36h11 => NonNull::new(ffi::tag36h11_create()).expect("no memory left for a code table"),
                };
                ffi::apriltag_detector_add_family_bits(detector.as_ptr(), table.as_ptr(), CORRECTED_BITS);
                assert!(!(*table.as_ptr()).impl_.is_null(), "no memory left for a code table");
                table
            };
            library.families.push((family, table));
        }
        library
    }

    /// Whether there is anything to look for; without, the library complains on standard error.
    pub(super) fn has_families(&self) -> bool {
        !self.families.is_empty()
    }

    /// Appends the markers found in the picture, in the library's order.
    pub(super) fn detect(&mut self, luma: LumaView<'_>, detections: &mut Vec<Detection>) {
        let side = |pixels: usize| i32::try_from(pixels).expect("checked by `LumaView::new`");
        let mut image = ffi::image_u8 {
            width: side(luma.width()),
            height: side(luma.height()),
            stride: side(luma.stride()),
            buf: luma.pixels().as_ptr().cast_mut(),
        };
        // SAFETY: `LumaView::new` has checked that `stride × height` bytes are there. Without decimation, blur and
        // debug pictures the library only reads them. The list and the detections in it are the library's, are read
        // before they are destroyed, and are not kept. `self.detector` is live and borrowed exclusively.
        unsafe {
            let list = ffi::apriltag_detector_detect(self.detector.as_ptr(), &raw mut image);
            assert!(!list.is_null(), "no memory left for a list of markers");
            let length = usize::try_from((*list).size).unwrap_or(0);
            let items = (*list).data.cast::<*mut ffi::apriltag_detection_t>();
            for index in 0..length {
                let found = &*items.add(index).read_unaligned();
                detections.extend(self.convert(found));
            }
            ffi::apriltag_detections_destroy(list);
        }
    }

    /// `None` for a detection that no marker can be: corners that are not finite, an unknown family.
    fn convert(&self, found: &ffi::apriltag_detection_t) -> Option<Detection> {
        let (family, _) = self.families.iter().find(|(_, table)| table.as_ptr() == found.family)?;
        let corners_px = found.p.map(|[x, y]| DVec2::new(x, y) - PIXEL_CENTRE);
        if !corners_px.iter().all(|corner| corner.is_finite()) {
            return None;
        }
        Some(Detection {
            family: *family,
            id: u32::try_from(found.id).ok()?,
            hamming: u32::try_from(found.hamming).ok()?,
            decision_margin: f64::from(found.decision_margin),
            corners_px,
        })
    }
}

impl Drop for Library {
    fn drop(&mut self) {
        // SAFETY: both were created in `new`, are freed once, the detector first because it refers to the families.
        unsafe {
            ffi::apriltag_detector_destroy(self.detector.as_ptr());
            for (family, table) in &self.families {
                match family {
                    Family::Tag36h11 => ffi::tag36h11_destroy(table.as_ptr()),
                }
            }
        }
    }
}
