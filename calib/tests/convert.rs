//! `mirrorball-calib convert`: from and to every format.

mod support;

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use glam::DVec3;
use mirrorball_calib::{
    interchange::Format,
    pose::Pose,
    rig::{RigParts, Role},
};
use support::RIG;

const CHAIN: &str = "cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.2, 0.59, 317.5, 316.25, 724.75, 546.5]
  resolution: [1440, 1080]
";

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// Standard output and standard error of a run that ends with this code.
fn said(arguments: &[&str], code: i32) -> (String, String) {
    let output = run(arguments);
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("text");
    let (out, error) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
    (out, error)
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let file = folder.join(name);
    fs::write(&file, text).expect("a temporary folder can be written");
    file.display().to_string()
}

#[test]
fn a_camera_goes_round_through_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let rig = write(folder.path(), "rig.toml", RIG);
    let original = RigParts::from_toml(RIG, Path::new("rig.toml")).unwrap();
    let original = original.camera("scene").unwrap().intrinsics.unwrap();
    let mut file = rig;
    for (format, name) in [
        ("ros", "scene"),
        ("opencv", "scene"),
        ("kalibr", "camera"),
        ("rig", "cam0"),
    ] {
        let to = folder.path().join(format!("{format}.yaml")).display().to_string();
        said(&["convert", &file, "--to", format, "--camera", name, "--out", &to], 0);
        file = to;
    }
    let back = RigParts::from_toml(&fs::read_to_string(&file).unwrap(), Path::new("rig.toml")).unwrap();
    let back = back.camera("cam0").expect("Kalibr's name").intrinsics.unwrap();
    assert_eq!(back, original);
}

#[test]
fn a_chain_becomes_a_rig_and_one_of_its_cameras_a_file_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let chain = write(folder.path(), "camchain.yaml", CHAIN);
    let (rig, warning) = said(&["convert", &chain, "--to", "rig"], 0);
    assert!(warning.contains("the cameras' poses are left out"), "{warning}");
    let parts = RigParts::from_toml(&rig, Path::new("rig.toml")).unwrap();
    let lenses: Vec<_> = parts
        .cameras
        .iter()
        .map(|camera| camera.intrinsics.unwrap().parameters())
        .collect();
    assert_eq!(
        lenses[0][..6],
        [461.629, 460.152, 362.680, 246.049, -0.276_954_97, 0.067_124_82]
    );
    assert_eq!(lenses[1], [317.5, 316.25, 724.75, 546.5, -0.2, 0.59]);
    let (ros, _) = said(
        &["convert", &chain, "--to", "ros", "--camera", "cam0", "--name", "left"],
        0,
    );
    let cameras = Format::Ros.read(&ros, Path::new("left.yaml")).unwrap();
    assert_eq!(
        (cameras[0].name.as_str(), cameras[0].intrinsics.parameters()),
        ("left", lenses[0].clone())
    );
}

#[test]
fn a_lens_is_put_into_the_rig_that_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let chain = write(folder.path(), "camchain.yaml", CHAIN);
    let rig = write(folder.path(), "rig.toml", RIG);
    said(
        &[
            "convert", &chain, "--to", "rig", "--camera", "cam1", "--name", "probe", "--out", &rig,
        ],
        0,
    );
    let parts = RigParts::from_toml(&fs::read_to_string(&rig).unwrap(), Path::new("rig.toml")).unwrap();
    let probe = parts.camera("probe").unwrap();
    assert_eq!((probe.role, probe.size_px), (Role::Fisheye, [1440, 1080]));
    assert_eq!(probe.intrinsics.unwrap().lens.coefficients(), [-0.2, 0.59]);
    assert!(probe.camera_from_world.is_some() && probe.photometry.is_some());
    assert_eq!(fs::read_to_string(format!("{rig}.old")).unwrap(), RIG);
}

#[test]
fn fixed_cameras_of_a_rig_become_a_chain_with_poses() {
    let folder = tempfile::tempdir().unwrap();
    // A second fixed camera, 0.2 m beside the first.
    let probe = RIG.find("[[camera]]\nname = \"probe\"").expect("the second camera");
    let end = probe + RIG[probe..].find("[[marker]]").expect("markers come after");
    let second = RIG[probe..end]
        .replacen("\"probe\"", "\"second\"", 1)
        .replacen("0.2]", "0.4]", 1);
    let text = format!("{}{second}{}", &RIG[..end], &RIG[end..]);
    let rig = write(folder.path(), "rig.toml", &text);
    let chain = folder.path().join("chain.yaml").display().to_string();
    // The scene camera's k3 is 0, so that Kalibr can hold it; it moves, so that nothing says where the next one is from it.
    said(&["convert", &rig, "--to", "kalibr", "--out", &chain], 0);
    let cameras = Format::Kalibr
        .read(&fs::read_to_string(&chain).unwrap(), Path::new("chain.yaml"))
        .unwrap();
    let poses: Vec<bool> = cameras
        .iter()
        .map(|camera| camera.camera_from_previous.is_some())
        .collect();
    assert_eq!(poses, [false, false, true]);
    let second_from_probe = cameras[2].camera_from_previous.unwrap();
    assert!(second_from_probe.translation.distance(DVec3::new(0.2, 0.0, 0.0)) < 1e-12);
    assert!(second_from_probe.angle_to(&Pose::identity()) < 1e-7);
}

#[test]
fn bad_input_is_named_with_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    let chain = write(folder.path(), "camchain.yaml", CHAIN);
    let omni = write(folder.path(), "omni.yaml", &CHAIN.replacen("pinhole", "omni", 1));
    let text = write(folder.path(), "text.yaml", "nothing: 1\n");
    let empty = write(
        folder.path(),
        "empty.toml",
        "version = 1\n[[camera]]\nname = \"a\"\nrole = \"scene\"\nsize_px = [4, 4]\n",
    );
    for (arguments, expected) in [
        (
            &["convert", &omni, "--to", "rig"][..],
            "line 2: the camera model `omni-radtan` is not supported",
        ),
        (
            &["convert", &text, "--to", "rig"],
            "is neither a rig file nor one of OpenCV, ROS or Kalibr",
        ),
        (&["convert", &empty, "--to", "ros"], "has no camera with a lens"),
        (
            &["convert", &chain, "--to", "opencv"],
            "holds one camera (there are: `cam0`, `cam1`)",
        ),
        (
            &["convert", &chain, "--to", "ros", "--camera", "cam1"],
            "cannot hold the model `double_sphere`",
        ),
        (
            &["convert", &chain, "--to", "ros", "--camera", "left"],
            "has no camera `left` with a lens (there are: `cam0`",
        ),
        (
            &["convert", &chain, "--to", "rig", "--name", "left"],
            "`--name` names one camera, but",
        ),
        (
            &["convert", &chain, "--to", "rig", "--camera", "cam0", "--name", "a/b"],
            "`camera.name` is `a/b`",
        ),
    ] {
        let (_, error) = said(arguments, 2);
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
    let (_, error) = said(&["convert", &omni, "--to", "rig"], 2);
    assert!(error.contains("\n  hint: "), "{error}");
}
