//! The programs for shadow methods: pictures without camera, and the bench.

use std::fs;

use crate::support::{data, has_adapter, program};

/// Runs `mirrorball-shadows`; gives exit code and what it said.
fn shadows(arguments: &[&str]) -> (i32, String) {
    let output = program("mirrorball-shadows").args(arguments).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn pictures_of_the_moving_test_scene_are_written() {
    if !has_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("pictures");
    let (code, said) = shadows(&[
        "--shadow",
        "none",
        "--light",
        "spot",
        "--size",
        "160x120",
        "--frames",
        "2",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{said}");
    let pictures = ["000000.png", "000001.png"].map(|name| image::open(out.join(name)).unwrap().into_rgb8());
    assert_eq!(pictures[0].dimensions(), (160, 120));
    assert_ne!(pictures[0], pictures[1]);
}

#[test]
fn a_scene_file_can_be_shown_instead() {
    if !has_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let scene = data("moving_lamp/scene/scene.toml");
    let out = folder.path().to_str().unwrap();
    let (code, said) = shadows(&[
        "--shadow",
        "none",
        "--scene",
        scene.to_str().unwrap(),
        "--size",
        "96x72",
        "--out",
        out,
    ]);
    assert_eq!(code, 0, "{said}");
    let picture = image::open(folder.path().join("000000.png")).unwrap().into_rgb8();
    let background = *picture.get_pixel(0, 0);
    assert!(picture.pixels().any(|&pixel| pixel != background));
}

#[test]
fn what_cannot_be_shown_is_named_and_ends_with_two() {
    for (arguments, word) in [
        (&["--shadow", "pcf10", "--out", "x"][..], "pcf9, pcf25"),
        (&["--light", "sun", "--out", "x"][..], "point, spot"),
        (&["--size", "640", "--out", "x"][..], "WxH"),
        (&["--shadow", "none"][..], "--out"),
        (&["--scene", "no/such.toml", "--out", "x"][..], "no/such.toml"),
    ] {
        let (code, said) = shadows(arguments);
        assert_eq!(code, 2, "{arguments:?}: {said}");
        assert!(said.contains(word), "{arguments:?}: {said}");
    }
    if !has_adapter() {
        return;
    }
    let file = tempfile::NamedTempFile::new().unwrap();
    let (code, said) = shadows(&[
        "--shadow",
        "none",
        "--size",
        "8x8",
        "--out",
        file.path().to_str().unwrap(),
    ]);
    assert_eq!(code, 2, "{said}");
    assert!(said.contains("cannot write"), "{said}");
}

#[test]
fn the_bench_prints_its_tables() {
    if !has_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let output = program("bench-shadows")
        .args(["--quick", "--only", "maps,volumes,growth", "--out"])
        .arg(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{said}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let rows = |start: &str| said.lines().filter(|line| line.starts_with(start)).count();
    assert_eq!([rows("| 64² |"), rows("| 128² |"), rows("| 256² |")], [5; 3], "{said}");
    assert_eq!([rows("| 0 |"), rows("| 20 |"), rows("| 100 |")], [3; 3], "{said}");
    assert_eq!(fs::read_to_string(folder.path().join("tables.md")).unwrap(), said);
    let csv = fs::read_to_string(folder.path().join("growth.csv")).unwrap();
    assert!(
        csv.contains("\nlights,dome,64,") && csv.contains("\ntriangles,pcf9,"),
        "{csv}"
    );
    assert!(folder.path().join("growth_triangles.png").exists());
}
