//! The one place that talks to AprilRobotics' C library (version 3.4.5).
#![expect(unsafe_code, reason = "the detector is a C library")]

use std::{ffi::CString, ptr::NonNull};

use apriltag_sys as ffi;
use glam::DVec2;

use super::{Detection, DictionarySize, Family, LumaView};

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
        let side = family.cells_per_side();
        let cells = match family {
            Family::Tag36h11 => tag36h11(|table| table.cells()),
            Family::Aruco4x4(_) | Family::Aruco5x5(_) | Family::Aruco6x6(_) => quadrants(side),
        };
        let codes = match family {
            Family::Tag36h11 => tag36h11(|table| table.codes().to_vec()),
            Family::Aruco4x4(_) | Family::Aruco5x5(_) | Family::Aruco6x6(_) => {
                let bits = side * side;
                let from_rows = |rows: u64| {
                    cells
                        .iter()
                        .fold(0, |code, [x, y]| code << 1 | (rows >> (bits - 1 - (y * side + x)) & 1))
                };
                family.dictionary().into_iter().map(from_rows).collect()
            }
        };
        let mut memory = Memory {
            codes,
            bit_x: cells.iter().map(|[x, _]| x + border_bits).collect(),
            bit_y: cells.iter().map(|[_, y]| y + border_bits).collect(),
            name: CString::new(family.name()).expect("names of families have no zero byte"),
        };
        let width = i32::try_from(side + 2 * border_bits).expect("checked by `Detector`: borders are thin");
        let raw = Box::new(ffi::apriltag_family_t {
            ncodes: family.codes(),
            codes: memory.codes.as_mut_ptr(),
            width_at_border: width,
            total_width: width + 2,
            reversed_border: false,
            nbits: side * side,
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

/// The cells of a square code in the order that the library can turn: a quarter of them, then the same turned clockwise,
/// three times, then the middle one of an odd square. Columns and rows from the top-left.
fn quadrants(side: u32) -> Vec<[u32; 2]> {
    let mut cells = Vec::with_capacity((side * side) as usize);
    let quarter = (0..side / 2).flat_map(|y| (0..side.div_ceil(2)).map(move |x| [x, y]));
    let mut quarter: Vec<[u32; 2]> = quarter.collect();
    for _ in 0..4 {
        cells.extend(&quarter);
        for cell in &mut quarter {
            *cell = [side - 1 - cell[1], cell[0]];
        }
    }
    if side % 2 == 1 {
        cells.push([side / 2; 2]);
    }
    cells
}

/// The library's own table of tag36h11.
struct Tag36h11<'a>(&'a ffi::apriltag_family_t);

impl Tag36h11<'_> {
    fn codes(&self) -> &[u64] {
        // SAFETY: the library says that there are `ncodes` of them, in static memory.
        unsafe { std::slice::from_raw_parts(self.0.codes, self.0.ncodes as usize) }
    }

    /// Columns and rows, from the top-left cell of the code; the library counts from the border's corner.
    fn cells(&self) -> Vec<[u32; 2]> {
        let count = self.0.nbits as usize;
        // SAFETY: both arrays have `nbits` elements and live as long as the family, which is borrowed.
        let (x, y) = unsafe {
            (
                std::slice::from_raw_parts(self.0.bit_x, count),
                std::slice::from_raw_parts(self.0.bit_y, count),
            )
        };
        x.iter().zip(y).map(|(x, y)| [x - 1, y - 1]).collect()
    }
}

/// Looks at the library's own table.
fn tag36h11<T>(read: impl FnOnce(Tag36h11<'_>) -> T) -> T {
    // SAFETY: the table is new, is only read, and is freed once, after `read` has given its borrow back.
    unsafe {
        let table = NonNull::new(ffi::tag36h11_create()).expect("no memory left for a code table");
        let result = read(Tag36h11(table.as_ref()));
        ffi::tag36h11_destroy(table.as_ptr());
        result
    }
}

/// A code of tag36h11, its cells row by row from the top-left, the first one the most significant bit.
pub(super) fn tag36h11_rows(id: u32) -> Option<u64> {
    let side = Family::Tag36h11.cells_per_side();
    tag36h11(|table| {
        let code = *table.codes().get(id as usize)?;
        let cells = table.cells();
        let bits = cells.len() as u32;
        let set = cells
            .iter()
            .zip((0..bits).rev())
            .filter(|(_, bit)| code >> bit & 1 == 1);
        Some(set.fold(0, |rows, ([x, y], _)| rows | 1 << (bits - 1 - (y * side + x))))
    })
}

/// Bits of a code that may be wrong and are corrected: the library's own default, less where codes are close to each
/// other (as OpenCV's `maxCorrectionBits`) or so many that the library's hash table would be huge.
fn corrected_bits(family: Family) -> i32 {
    match family {
        Family::Aruco4x4(DictionarySize::N1000) => 0,
        Family::Aruco4x4(_) | Family::Aruco5x5(DictionarySize::N1000) | Family::Aruco6x6(DictionarySize::N1000) => 1,
        Family::Tag36h11 | Family::Aruco5x5(_) | Family::Aruco6x6(_) => 2,
    }
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
                ffi::apriltag_detector_add_family_bits(detector.as_ptr(), table.raw.as_ptr(), corrected_bits(family));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The library's own order is one that can be turned; ours must be of the same kind.
    #[test]
    fn a_quarter_of_the_cells_turned_is_the_next_quarter() {
        let turned = |cells: &[[u32; 2]], side: u32| {
            let quarter = cells.len() / 4;
            (0..3 * quarter).all(|i| cells[i + quarter] == [side - 1 - cells[i][1], cells[i][0]])
        };
        assert!(turned(&tag36h11(|table| table.cells()), 6));
        for side in 4..=6 {
            let mut cells = quadrants(side);
            assert!(turned(&cells, side));
            assert_eq!(cells.len(), (side * side) as usize);
            cells.sort();
            cells.dedup();
            assert_eq!(cells.len(), (side * side) as usize);
        }
    }
}
