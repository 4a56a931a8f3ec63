//! What board files say, and what is wrong with them.

use super::*;
use crate::tag::DictionarySize;

fn read(text: &str) -> Result<Board, BoardFileError> {
    Board::from_text(text, Path::new("board"))
}

fn message(text: &str) -> String {
    read(text).unwrap_err().to_string()
}

const APRILGRID: &str =
    "kind = \"aprilgrid\"\nfamily = \"tag36h11\"\ncolumns = 6\nrows = 5\nside_m = 0.03\nspacing_m = 0.009\n";
const CHARUCO: &str =
    "kind = \"charuco\"\nfamily = \"aruco_5x5_100\"\ncolumns = 8\nrows = 6\nsquare_m = 0.03\nside_m = 0.022\n";
const CHESSBOARD: &str = "kind = \"chessboard\"\ncolumns = 9\nrows = 6\nsquare_m = 0.025\n";
const KALIBR: &str = "target_type: 'aprilgrid' #gridtype\ntagCols: 6               #number of apriltags\ntagRows: 5\ntagSize: 0.088           #[m]\ntagSpacing: 0.3          #ratio\n";

#[test]
fn every_kind_is_read() {
    let grid = |side_m, spacing_m, border_bits, first_id| Board::AprilGrid {
        family: Family::Tag36h11,
        columns: 6,
        rows: 5,
        side_m,
        spacing_m,
        border_bits,
        first_id,
    };
    assert_eq!(read(APRILGRID), Ok(grid(0.03, 0.009, 1, 0)));
    let more = format!("{APRILGRID}border_bits = 2\nfirst_id = 557\n");
    assert_eq!(read(&more), Ok(grid(0.03, 0.009, 2, 557)));
    assert_eq!(read(KALIBR), Ok(grid(0.088, 0.3 * 0.088, 2, 0)));
    assert_eq!(
        read(&format!("{KALIBR}codeOffset: 12\n")),
        Ok(grid(0.088, 0.3 * 0.088, 2, 12))
    );
    let charuco = |pattern| Board::Charuco {
        family: Family::Aruco5x5(DictionarySize::N100),
        columns: 8,
        rows: 6,
        square_m: 0.03,
        side_m: 0.022,
        first_id: 0,
        pattern,
    };
    assert_eq!(read(CHARUCO), Ok(charuco(CharucoPattern::BlackTopLeft)));
    assert_eq!(
        read(&format!("{CHARUCO}legacy = true\n")),
        Ok(charuco(CharucoPattern::BlackBottomLeft))
    );
    let chessboard = Board::Chessboard {
        columns: 9,
        rows: 6,
        square_m: 0.025,
    };
    assert_eq!(read(CHESSBOARD), Ok(chessboard));
    let kalibr =
        "target_type: checkerboard\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.025\ncolSpacingMeters: 0.025\n";
    assert_eq!(read(kalibr), Ok(chessboard));
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    assert_eq!(
        message(&APRILGRID.replace("rows = 5", "rows = 0")),
        "`board`, line 4: `rows` is `0` (allowed: 1 to 60)"
    );
    assert_eq!(
        message(&APRILGRID.replace("side_m = 0.03", "side_m = 30.0")),
        "`board`, line 5: `side_m` is `30` (allowed: more than 0, at most 10, in metres)"
    );
    assert_eq!(
        message(&format!("{APRILGRID}first_id = 558\n")),
        "`board`, line 7: `first_id` is `558` (allowed: 0 to 557: the board has `30` markers, `tag36h11` has `587`)"
    );
    assert_eq!(
        message(&CHARUCO.replace("side_m = 0.022", "side_m = 0.03")),
        "`board`, line 6: `side_m` is `0.03` (allowed: more than 0, less than `square_m`, which is `0.03`)"
    );
    assert_eq!(
        message(&format!("{CHESSBOARD}side_m = 0.02\n")),
        "`board`, line 5: `side_m` means nothing for `chessboard`"
    );
    assert_eq!(
        message(&CHESSBOARD.replace("square_m = 0.025\n", "")),
        "`board` lacks `square_m`, which `chessboard` needs"
    );
    assert_eq!(
        message(&CHESSBOARD.replace("chessboard", "circles")),
        "`board`, line 1: `kind` is `circles` (allowed: `aprilgrid`, `charuco`, `chessboard`)"
    );
    let unknown = message(&format!("{CHESSBOARD}sidem = 0.02\n"));
    assert!(
        unknown.starts_with("`board`, line 5: unknown field `sidem`"),
        "{unknown}"
    );
    assert!(
        message(&APRILGRID.replace("tag36h11", "tag36h10"))
            .contains("line 2: `family` is `tag36h10` (allowed: `tag36h11`")
    );
}

#[test]
fn the_same_goes_for_kalibrs_files() {
    assert_eq!(
        message(&KALIBR.replace("tagRows: 5", "tagRows: -5")),
        "`board`, line 3: `tagRows` is `-5` (allowed: 1 to 60)"
    );
    assert_eq!(
        message(&KALIBR.replace("tagRows: 5\n", "")),
        "`board` lacks `tagRows`, which `aprilgrid` needs"
    );
    let circles = KALIBR.replace("'aprilgrid'", "circlegrid");
    assert_eq!(
        message(&circles),
        "`board`, line 1: `target_type` is `circlegrid` (allowed: `aprilgrid`, `checkerboard`)"
    );
    let unknown = message(&format!("{KALIBR}tagColour: red\n"));
    assert!(
        unknown.starts_with("`board`, line 6: ") && unknown.contains("tagColour"),
        "{unknown}"
    );
    let oblong =
        "target_type: checkerboard\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.02\ncolSpacingMeters: 0.025\n";
    assert_eq!(
        message(oblong),
        "`board`, line 4: `rowSpacingMeters` is `0.02` (allowed: the same as `colSpacingMeters`: squares)"
    );
}

#[test]
fn nonsense_is_refused() {
    for text in ["", "target_type:", "target_type: [", "kind", "kind = 3", "\u{0}"] {
        assert!(read(text).is_err(), "{text:?}");
    }
}
