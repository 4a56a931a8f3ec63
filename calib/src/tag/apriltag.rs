//! The one place that talks to AprilRobotics' C library (version 3.4.5).
#![expect(unsafe_code, reason = "the detector is a C library")]

use std::{ffi::CString, ptr::NonNull};

use apriltag_sys as ffi;
use glam::DVec2;

use super::{Detection, Family, Layout, LumaView, codebook::corrected_bits};

/// Offset of the library's pixel centres from ours, which are integers.
const PIXEL_CENTRE: f64 = 0.5;

/// A detector of the C library with its families. One thread, no decimation, so results are repeatable.
pub(super) struct Library {
    detector: NonNull<ffi::apriltag_detector_t>,
    families: Vec<Table>,
}

/// A family as the library wants it. The memory is ours; the library adds a hash table while a detector uses it.
struct Table {
    family: Family,
    raw: NonNull<ffi::apriltag_family_t>,
    /// What `raw` points to.
    _memory: Memory,
}

/// The arrays of a family.
struct Memory {
    codes: Vec<u64>,
    bit_x: Vec<u32>,
    bit_y: Vec<u32>,
    name: CString,
}

impl Table {
    fn new(family: Family, border_bits: u32) -> Self {
        let layout = Layout::new(family, border_bits);
        let cells = turnable(layout.code_cells(), layout.quad_cells() as i32);
        let code_of = |id| {
            let code = family.code(id).expect("ids are below the number of codes");
            let n = cells.len();
            let bit = |cell| {
                let place = layout.code_cells().iter().position(|known| known == cell);
                code >> (n - 1 - place.expect("the same cells in another order")) & 1
            };
            cells.iter().fold(0, |code, cell| code << 1 | bit(cell))
        };
        let mut memory = Memory {
            codes: (0..family.codes()).map(code_of).collect(),
            bit_x: cells.iter().map(|[x, _]| x.cast_unsigned()).collect(),
            bit_y: cells.iter().map(|[_, y]| y.cast_unsigned()).collect(),
            name: CString::new(family.name()).expect("names of families have no zero byte"),
        };
        let width = i32::try_from(layout.quad_cells()).expect("checked by `Detector`: borders are thin");
        let raw = Box::new(ffi::apriltag_family_t {
            ncodes: family.codes(),
            codes: memory.codes.as_mut_ptr(),
            width_at_border: width,
            total_width: width + 2 * layout.margin_cells() as i32,
            reversed_border: layout.is_white_inside(),
            nbits: cells.len() as u32,
            bit_x: memory.bit_x.as_mut_ptr(),
            bit_y: memory.bit_y.as_mut_ptr(),
            h: 0,
            name: memory.name.as_ptr().cast_mut(),
            impl_: std::ptr::null_mut(),
        });
        Self {
            family,
            raw: NonNull::from(Box::leak(raw)),
            _memory: memory,
        }
    }
}

impl Drop for Table {
    fn drop(&mut self) {
        // SAFETY: the pointer comes from a leaked box and is freed here only; the detector that knew it is gone, see
        // `Library::drop`, and has freed its hash table.
        drop(unsafe { Box::from_raw(self.raw.as_ptr()) });
    }
}

/// The cells in an order that the library can turn: a quarter of them, then the same turned clockwise, three times, then the
/// middle one of an odd square.
fn turnable(cells: &[[i32; 2]], side: i32) -> Vec<[i32; 2]> {
    let turned = |[x, y]: [i32; 2]| [side - 1 - y, x];
    let mut quarter: Vec<[i32; 2]> = Vec::new();
    let mut known: Vec<[i32; 2]> = Vec::new();
    for &cell in cells {
        if !known.contains(&cell) && turned(cell) != cell {
            quarter.push(cell);
            let mut next = cell;
            for _ in 0..4 {
                known.push(next);
                next = turned(next);
            }
        }
    }
    let mut all = Vec::with_capacity(cells.len());
    for _ in 0..4 {
        all.extend(&quarter);
        for cell in &mut quarter {
            *cell = turned(*cell);
        }
    }
    all.extend(cells.iter().filter(|&&cell| turned(cell) == cell));
    all
}

// SAFETY: the library keeps no state outside the detector and its families, which this type owns alone, and with one
// thread it starts no worker whose identity could matter.
unsafe impl Send for Library {}

impl Library {
    pub(super) fn new(families: &[Family], border_bits: u32) -> Self {
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
            if library.families.iter().any(|known| known.family == family) {
                continue;
            }
            let table = Table::new(family, border_bits);
            // SAFETY: the family is new, is added to a live detector once, and outlives it: `drop` frees it afterwards.
            unsafe {
                ffi::apriltag_detector_add_family_bits(
                    detector.as_ptr(),
                    table.raw.as_ptr(),
                    corrected_bits(family) as i32,
                );
                assert!(
                    !(*table.raw.as_ptr()).impl_.is_null(),
                    "no memory left for a code table"
                );
            }
            library.families.push(table);
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
            buf: luma.bytes().as_ptr().cast_mut(),
        };
        // SAFETY: `LumaView::new` has checked that all rows are there and `Detector` that pixels are a byte apart. Without decimation, blur and
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
        let table = self.families.iter().find(|table| table.raw.as_ptr() == found.family)?;
        let corners_px = found.p.map(|[x, y]| DVec2::new(x, y) - PIXEL_CENTRE);
        if !corners_px.iter().all(|corner| corner.is_finite()) {
            return None;
        }
        Some(Detection {
            family: table.family,
            id: u32::try_from(found.id).ok()?,
            hamming: u32::try_from(found.hamming).ok()?,
            decision_margin: f64::from(found.decision_margin),
            corners_px,
        })
    }
}

impl Drop for Library {
    fn drop(&mut self) {
        // SAFETY: it was created in `new` and is freed once, before the families that it refers to.
        unsafe { ffi::apriltag_detector_destroy(self.detector.as_ptr()) };
    }
}
