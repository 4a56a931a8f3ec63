//! Bad input to the render node: exit code 2, and a message that names file and field.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{data, program};

/// A copy of a carried recording with its scene, to be broken.
struct Broken {
    folder: tempfile::TempDir,
}

impl Broken {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&data("two_cameras/recording"), &folder.path().join("recording"));
        copy(&data("two_cameras/scene"), &folder.path().join("scene"));
        Self { folder }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn replace(&self, name: &str, from: &str, to: &str) {
        let text = fs::read_to_string(self.file(name)).unwrap();
        assert!(text.contains(from), "`{from}` is not in `{name}`");
        fs::write(self.file(name), text.replacen(from, to, 1)).unwrap();
    }

    /// Runs the render node; gives exit code and what it said.
    fn run(&self, more: &[&str]) -> (i32, String) {
        let output = program("mirrorball-render")
            .args(["--recording".as_ref(), self.file("recording").as_os_str()])
            .args(["--scene".as_ref(), self.file("scene/scene.toml").as_os_str()])
            .args(["--out".as_ref(), self.file("out").as_os_str()])
            .args(more)
            .output()
            .unwrap();
        (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
    }

    fn assert_refused(&self, expected: &[&str]) {
        let (code, said) = self.run(&[]);
        assert_eq!(code, 2, "{said}");
        for word in expected.iter().chain(&["error: "]) {
            assert!(said.contains(word), "`{word}` is not in: {said}");
        }
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::write(target, fs::read(entry.path()).unwrap()).unwrap();
        }
    }
}

#[test]
fn a_missing_recording() {
    let broken = Broken::new();
    fs::remove_dir_all(broken.file("recording")).unwrap();
    broken.assert_refused(&["rig.toml", "hint: "]);
}

#[test]
fn a_recording_without_its_frame_list() {
    let broken = Broken::new();
    fs::remove_file(broken.file("recording/frames.csv")).unwrap();
    broken.assert_refused(&["frames.csv"]);
}

#[test]
fn a_rig_without_markers() {
    let broken = Broken::new();
    let text = fs::read_to_string(broken.file("recording/rig.toml")).unwrap();
    let start = text.find("[[marker]]").unwrap();
    let end = text.find("[ball]").unwrap();
    fs::write(
        broken.file("recording/rig.toml"),
        format!("{}{}", &text[..start], &text[end..]),
    )
    .unwrap();
    broken.assert_refused(&["rig.toml", "marker"]);
}

#[test]
fn an_unknown_camera_model() {
    let broken = Broken::new();
    broken.replace("recording/rig.toml", "brown_conrady", "pinhole_of_alhazen");
    broken.assert_refused(&["rig.toml", "pinhole_of_alhazen", "brown_conrady"]);
}

#[test]
fn a_pose_that_is_not_a_number() {
    let broken = Broken::new();
    broken.replace("scene/scene.toml", "0.838670568", "nan");
    broken.assert_refused(&["scene.toml", "mirror_cube", "world_from_object"]);
}

#[test]
fn an_unknown_key_in_the_scene() {
    let broken = Broken::new();
    broken.replace("scene/scene.toml", "mesh_up", "mesh_upp");
    broken.assert_refused(&["scene.toml", "mesh_upp"]);
}

#[test]
fn an_unreadable_mesh() {
    let broken = Broken::new();
    fs::write(broken.file("scene/clay_vase.glb"), b"glTF, but not really").unwrap();
    broken.assert_refused(&["clay_vase.glb", "clay_vase"]);
}

#[test]
fn a_picture_of_the_wrong_size() {
    if !crate::support::has_adapter() {
        return;
    }
    let broken = Broken::new();
    broken.replace("recording/rig.toml", "size_px = [640, 480]", "size_px = [320, 240]");
    broken.assert_refused(&["640"]);
}

#[test]
fn an_exposure_that_is_none() {
    for exposure in ["0", "NaN", "-0.01", "inf", ""] {
        let broken = Broken::new();
        let second_frame = "scene/000004.png,0.004694";
        broken.replace(
            "recording/frames.csv",
            second_frame,
            &format!("scene/000004.png,{exposure}"),
        );
        broken.assert_refused(&["frames.csv", "line 4", "exposure_s"]);
    }
}

#[test]
fn frames_whose_size_changes() {
    if !crate::support::has_adapter() {
        return;
    }
    for (picture, size_px) in [("probe/000004.png", [320, 240]), ("scene/000004.png", [641, 480])] {
        let broken = Broken::new();
        let [width, height] = size_px;
        let path = broken.file(&format!("recording/{picture}"));
        image::RgbImage::new(width, height).save(path).unwrap();
        broken.assert_refused(&["640", "480", &width.to_string(), "000004"]);
    }
}

#[test]
fn an_output_folder_that_cannot_be_written() {
    let broken = Broken::new();
    fs::write(broken.file("out"), b"a file stands where the folder should be").unwrap();
    broken.assert_refused(&["out"]);
}

#[test]
fn a_frame_that_cannot_be_read_stops_or_is_skipped() {
    if !crate::support::has_adapter() {
        return;
    }
    let broken = Broken::new();
    fs::write(broken.file("recording/scene/000003.png"), b"no picture").unwrap();
    broken.assert_refused(&["000003.png"]);
    let (code, said) = broken.run(&["--skip-bad-frames"]);
    assert_eq!(code, 0, "{said}");
    assert!(
        said.contains("skipped=1") || said.contains("skipped\u{1b}[0m\u{1b}[2m=\u{1b}[0m1"),
        "{said}"
    );
    assert!(broken.file("out/composite/000004.png").exists());
    assert!(!broken.file("out/composite/000003.png").exists());
}

#[test]
fn no_vulkan_adapter() {
    let broken = Broken::new();
    let output = program("mirrorball-render")
        .args(["--recording".as_ref(), broken.file("recording").as_os_str()])
        .args(["--scene".as_ref(), broken.file("scene/scene.toml").as_os_str()])
        .args(["--out".as_ref(), broken.file("out").as_os_str()])
        .env("VK_DRIVER_FILES", "/nonexistent.json")
        .env("VK_ICD_FILENAMES", "/nonexistent.json")
        .output()
        .unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("no Vulkan adapter") && said.contains("mesa-vulkan-drivers"),
        "{said}"
    );
}
