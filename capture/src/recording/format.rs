//! The frame list `frames.csv`: read whole, checked field by field, so that playing meets no surprise but in pictures.

use std::path::{Component, Path, PathBuf};
use std::str::FromStr;

use crate::frame::{Exposure, FrameMeta};
use crate::source::{CameraDescription, CameraRole, SourceError};

/// Columns of the frame list, in this order.
pub(super) const COLUMNS: [&str; 9] = [
    "camera",
    "sequence",
    "timestamp_ns",
    "file",
    "exposure_s",
    "gain",
    "wb_r",
    "wb_g",
    "wb_b",
];

/// Largest time stamp and sequence number; the room above is for the shift when a recording is repeated.
const COUNT_MAX: u64 = 1 << 62;

/// Most frames in one list, a bound on memory.
const FRAMES_MAX: usize = 1 << 22;

/// One line of the frame list.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    /// Line number, the header being 1.
    pub(super) line: u64,
    /// Index of the camera in the rig.
    pub(super) camera_index: usize,
    /// Who, when, how.
    pub(super) meta: FrameMeta,
    /// The picture, relative to the folder of the recording.
    pub(super) file: PathBuf,
}

/// Reads the frame list at `path`; `cameras` are those of the rig.
pub(super) fn read_frame_list(path: &Path, cameras: &[CameraDescription]) -> Result<Vec<Entry>, SourceError> {
    let file = std::fs::File::open(path).map_err(|source| SourceError::ReadFile {
        path: path.to_path_buf(),
        source,
    })?;
    parse_frame_list(path, file, cameras)
}

fn parse_frame_list(
    path: &Path,
    list: impl std::io::Read,
    cameras: &[CameraDescription],
) -> Result<Vec<Entry>, SourceError> {
    // With CR LF as one terminator the reader would count lines one too low; so the CR is trimmed as white space.
    let mut builder = csv::ReaderBuilder::new();
    let mut reader = builder
        .terminator(csv::Terminator::Any(b'\n'))
        .trim(csv::Trim::All)
        .from_reader(list);
    check_header(path, &mut reader)?;
    let mut entries: Vec<Entry> = Vec::new();
    let mut last_of_camera: Vec<Option<(u64, u64)>> = vec![None; cameras.len()];
    for record in reader.records() {
        let record = record.map_err(|source| syntax_error(path, source))?;
        let line = Line {
            path,
            number: record.position().map_or(0, csv::Position::line),
            record: &record,
        };
        let entry = parse_entry(&line, cameras)?;
        check_order(&line, &entry, entries.last(), last_of_camera[entry.camera_index])?;
        if entries.len() == FRAMES_MAX {
            return Err(line.bad_value(Column::Sequence, format!("at most {FRAMES_MAX} frames in one list")));
        }
        last_of_camera[entry.camera_index] = Some((entry.meta.timestamp_ns, entry.meta.sequence));
        entries.push(entry);
    }
    check_leader(path, &entries, cameras)?;
    Ok(entries)
}

/// Columns by number.
#[derive(Debug, Clone, Copy)]
enum Column {
    Camera = 0,
    Sequence = 1,
    TimestampNs = 2,
    File = 3,
    ExposureS = 4,
    Gain = 5,
    WbR = 6,
    WbG = 7,
    WbB = 8,
}

/// A line being read, with what an error about it has to say.
struct Line<'a> {
    path: &'a Path,
    number: u64,
    record: &'a csv::StringRecord,
}

impl Line<'_> {
    fn text(&self, column: Column) -> &str {
        self.record.get(column as usize).unwrap_or_default()
    }

    fn bad_value(&self, column: Column, allowed: impl Into<String>) -> SourceError {
        SourceError::ListValue {
            path: self.path.to_path_buf(),
            line: self.number,
            field: COLUMNS[column as usize],
            found: self.text(column).to_owned(),
            allowed: allowed.into(),
        }
    }

    fn count(&self, column: Column) -> Result<u64, SourceError> {
        let count = u64::from_str(self.text(column))
            .ok()
            .filter(|&count| count <= COUNT_MAX);
        count.ok_or_else(|| self.bad_value(column, format!("a whole number of 0..={COUNT_MAX}")))
    }

    fn positive(&self, column: Column) -> Result<f64, SourceError> {
        let value = f64::from_str(self.text(column))
            .ok()
            .filter(|value| value.is_finite() && *value > 0.0);
        value.ok_or_else(|| self.bad_value(column, "a finite number above 0"))
    }
}

fn check_header<R: std::io::Read>(path: &Path, reader: &mut csv::Reader<R>) -> Result<(), SourceError> {
    let header = reader.headers().map_err(|source| syntax_error(path, source))?;
    if header.iter().eq(COLUMNS) {
        return Ok(());
    }
    Err(SourceError::ListHeader {
        path: path.to_path_buf(),
        found: header.iter().collect::<Vec<_>>().join(","),
        expected: COLUMNS.join(","),
    })
}

fn parse_entry(line: &Line<'_>, cameras: &[CameraDescription]) -> Result<Entry, SourceError> {
    let name = line.text(Column::Camera);
    let Some(camera_index) = cameras.iter().position(|camera| &*camera.name == name) else {
        let names: Vec<_> = cameras.iter().map(|camera| format!("`{}`", camera.name)).collect();
        return Err(line.bad_value(Column::Camera, format!("a camera of the rig: {}", names.join(", "))));
    };
    let file = Path::new(line.text(Column::File));
    let stays_inside = file
        .components()
        .all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if file.file_name().is_none() || !stays_inside {
        return Err(line.bad_value(
            Column::File,
            "a path inside the recording, without `..`, relative to its folder",
        ));
    }
    let exposure = Exposure {
        time_s: line.positive(Column::ExposureS)?,
        gain: line.positive(Column::Gain)?,
        white_balance: [
            line.positive(Column::WbR)?,
            line.positive(Column::WbG)?,
            line.positive(Column::WbB)?,
        ],
    };
    let meta = FrameMeta::new(
        cameras[camera_index].name.clone(),
        line.count(Column::Sequence)?,
        line.count(Column::TimestampNs)?,
        exposure,
    );
    Ok(Entry {
        line: line.number,
        camera_index,
        meta,
        file: file.to_path_buf(),
    })
}

fn check_order(
    line: &Line<'_>,
    entry: &Entry,
    before: Option<&Entry>,
    before_of_camera: Option<(u64, u64)>,
) -> Result<(), SourceError> {
    let earliest_ns = before.map_or(0, |before| before.meta.timestamp_ns);
    if entry.meta.timestamp_ns < earliest_ns {
        return Err(line.bad_value(
            Column::TimestampNs,
            format!("at least {earliest_ns}, that of the line before"),
        ));
    }
    let Some((timestamp_ns, sequence)) = before_of_camera else {
        return Ok(());
    };
    if entry.meta.timestamp_ns <= timestamp_ns {
        return Err(line.bad_value(
            Column::TimestampNs,
            format!("above {timestamp_ns}, the camera's frame before"),
        ));
    }
    if entry.meta.sequence <= sequence {
        return Err(line.bad_value(Column::Sequence, format!("above {sequence}, the camera's frame before")));
    }
    Ok(())
}

fn check_leader(path: &Path, entries: &[Entry], cameras: &[CameraDescription]) -> Result<(), SourceError> {
    let leads = |entry: &Entry| cameras[entry.camera_index].role == CameraRole::Scene;
    if entries.iter().any(leads) {
        return Ok(());
    }
    let leader = cameras.iter().find(|camera| camera.role == CameraRole::Scene);
    Err(SourceError::NoLeaderFrame {
        path: path.to_path_buf(),
        leader: leader.map_or_else(String::new, |camera| camera.name.to_string()),
    })
}

fn syntax_error(path: &Path, source: csv::Error) -> SourceError {
    let line = source.position().map_or(0, csv::Position::line);
    SourceError::ListSyntax {
        path: path.to_path_buf(),
        line,
        source,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::frame::{PixelFormat, Size};

    fn cameras() -> Vec<CameraDescription> {
        let size = Size { width: 4, height: 2 };
        [("scene", CameraRole::Scene), ("probe", CameraRole::Ball)]
            .map(|(name, role)| CameraDescription {
                name: name.into(),
                role,
                size,
                format: PixelFormat::Rgb8,
            })
            .to_vec()
    }

    fn parse(lines: &str) -> Result<Vec<Entry>, SourceError> {
        let text = format!("{}\n{lines}", COLUMNS.join(","));
        parse_frame_list(Path::new("frames.csv"), text.as_bytes(), &cameras())
    }

    #[test]
    fn a_good_list_is_read_whole() {
        let entries = parse("scene,0,10,scene/0.png,0.01,1,1.5,1,2\nprobe,7,10,probe/0.png,0.02,2,1,1,1\n").unwrap();
        assert_eq!(entries.len(), 2);
        assert_eq!(entries[0].meta.exposure.white_balance, [1.5, 1.0, 2.0]);
        assert_eq!(
            (entries[1].line, entries[1].camera_index, entries[1].meta.sequence),
            (3, 1, 7)
        );
    }

    #[test]
    fn lines_may_end_as_on_windows() {
        let list = format!(
            "{}\r\nscene,0,1,a.png,1,1,1,1,1\r\nscene,0,2,b.png,1,1,1,1,1\r\n",
            COLUMNS.join(",")
        );
        let error = parse_frame_list(Path::new("f"), list.as_bytes(), &cameras()).unwrap_err();
        assert!(
            matches!(
                error,
                SourceError::ListValue {
                    line: 3,
                    field: "sequence",
                    ..
                }
            ),
            "{error}"
        );
    }

    #[test]
    fn other_columns_are_refused() {
        for header in [
            "camera,sequence",
            &format!("{},iso", COLUMNS.join(",")),
            "sequence,camera",
            "",
        ] {
            let error = parse_frame_list(Path::new("f"), format!("{header}\n").as_bytes(), &cameras()).unwrap_err();
            assert!(matches!(error, SourceError::ListHeader { .. }), "{error}");
        }
    }

    #[test]
    fn every_bad_field_is_named_with_its_line() {
        let cases = [
            ("moon,0,1,a.png,1,1,1,1,1", "camera"),
            ("scene,-1,1,a.png,1,1,1,1,1", "sequence"),
            ("scene,0,1.5,a.png,1,1,1,1,1", "timestamp_ns"),
            ("scene,0,9223372036854775808,a.png,1,1,1,1,1", "timestamp_ns"),
            ("scene,0,1,/etc/a.png,1,1,1,1,1", "file"),
            ("scene,0,1,scene/../../a.png,1,1,1,1,1", "file"),
            ("scene,0,1,,1,1,1,1,1", "file"),
            ("scene,0,1,a.png,0,1,1,1,1", "exposure_s"),
            ("scene,0,1,a.png,NaN,1,1,1,1", "exposure_s"),
            ("scene,0,1,a.png,1,inf,1,1,1", "gain"),
            ("scene,0,1,a.png,1,1,-1,1,1", "wb_r"),
            ("scene,0,1,a.png,1,1,1,x,1", "wb_g"),
            ("scene,0,1,a.png,1,1,1,1,", "wb_b"),
        ];
        for (line, column) in cases {
            let error = parse(line).unwrap_err();
            let SourceError::ListValue { line: 2, field, .. } = &error else {
                panic!("{error}")
            };
            assert_eq!(*field, column, "{error}");
        }
    }

    #[test]
    fn order_is_checked() {
        let cases = [
            ("scene,0,5,a,1,1,1,1,1\nprobe,0,4,b,1,1,1,1,1", "timestamp_ns"),
            ("scene,0,5,a,1,1,1,1,1\nscene,1,5,b,1,1,1,1,1", "timestamp_ns"),
            ("scene,3,5,a,1,1,1,1,1\nscene,3,6,b,1,1,1,1,1", "sequence"),
        ];
        for (lines, column) in cases {
            let error = parse(lines).unwrap_err();
            let SourceError::ListValue { line: 3, field, .. } = &error else {
                panic!("{error}")
            };
            assert_eq!(*field, column, "{error}");
        }
    }

    #[test]
    fn short_lines_and_empty_lists_are_refused() {
        assert!(matches!(
            parse("scene,0,1\n").unwrap_err(),
            SourceError::ListSyntax { line: 2, .. }
        ));
        assert!(matches!(parse("").unwrap_err(), SourceError::NoLeaderFrame { .. }));
        let only_probe = parse("probe,0,1,a,1,1,1,1,1").unwrap_err();
        assert!(matches!(only_probe, SourceError::NoLeaderFrame { .. }));
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC{0,200}") {
            let _ = parse(&text);
        }

        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let list = [COLUMNS.join(",").as_bytes(), b"\n", &bytes[..]].concat();
            let _ = parse_frame_list(Path::new("f"), &list[..], &cameras());
        }

        #[test]
        fn what_is_written_is_read(
            sequence in 0..=COUNT_MAX, timestamp_ns in 0..=COUNT_MAX, time_s in 1e-9f64..1e3, gain in 1e-3f64..1e3,
        ) {
            let entries = parse(&format!("scene,{sequence},{timestamp_ns},a.png,{time_s},{gain},1,1,1")).unwrap();
            let meta = &entries[0].meta;
            prop_assert_eq!((meta.sequence, meta.timestamp_ns), (sequence, timestamp_ns));
            prop_assert_eq!((meta.exposure.time_s, meta.exposure.gain), (time_s, gain));
        }
    }
}
