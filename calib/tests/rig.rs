//! Rig files: a whole one, and every way in which one can be wrong.

mod support;

use std::{error::Error, f64::consts::PI, path::Path};

use glam::{DVec2, DVec3};
use mirrorball_calib::{
    camera::LensModel,
    rig::{Rig, RigDraft, RigError, Role},
};
use proptest::prelude::*;
use support::RIG;

/// What to replace in the rig, by what, and what the error must contain.
const OUT_OF_RANGE: [(&str, &str, &str); 23] = [
    (
        "version = 1",
        "version = 2",
        "line 1: `version` is `2`, from a newer program",
    ),
    (
        "name = \"scene\"",
        "name = \"../x\"",
        "line 5: `camera.name` is `../x` (allowed: letters",
    ),
    (
        "role = \"scene\"",
        "role = \"side\"",
        "line 6: `camera.role` is `side` (allowed: `scene`, `ball`, `fisheye`)",
    ),
    (
        "[640, 480]",
        "[640, 0]",
        "line 7: `camera.size_px` is `[640, 0]` (allowed: width and height of 1 to 16384)",
    ),
    (
        "[605.5, 605.0]",
        "[605.5, -1.0]",
        "`camera.lens.focal_px` is `[605.5, -1.0]` (allowed: two finite numbers",
    ),
    (
        "[320.9, 238.4]",
        "[nan, 238.4]",
        "`camera.lens.principal_point_px` is `[NaN, 238.4]` (allowed: finite",
    ),
    (
        "-0.0004, ",
        "",
        "`camera.lens.distortion` is `[-0.062, 0.022, 0.0003, 0.0]` (allowed: five finite numbers",
    ),
    ("0.00021]", "inf]", "(allowed: four finite numbers: k1, k2, k3, k4)"),
    (
        "0.00021]",
        "-0.21]",
        "(allowed: a distortion that maps rays to pixels one to one)",
    ),
    (
        "max_angle_deg = 92.5",
        "max_angle_deg = 181",
        "`camera.lens.max_angle_deg` is `181.0` (allowed: above 0",
    ),
    (
        "sensitivity = 40.0",
        "sensitivity = 0.0",
        "`camera.photometry.sensitivity` is `0.0` (allowed: a finite number",
    ),
    (
        "[-0.1, 0.0]",
        "[-1.5, 0.0]",
        "`camera.photometry.vignetting` is `[-1.5, 0.0]` (allowed: 1 + v1 r²",
    ),
    (
        "read_noise_e = 6.0",
        "read_noise_e = -6.0",
        "`camera.photometry.read_noise_e` is `-6.0` (allowed:",
    ),
    (
        "\"srgb\"",
        "\"linear\"",
        "`camera.photometry.response` is `linear` (allowed: `srgb` or a list of 256 numbers)",
    ),
    (
        "[1.1, -0.1, 0.0]",
        "[0.0, 0.0, 0.0]",
        "(allowed: three rows of three finite numbers that can be inverted)",
    ),
    (
        "family = \"tag36h11\"",
        "family = \"tag16h5\"",
        "`marker.family` is `tag16h5` (allowed: `tag36h11`)",
    ),
    ("id = 586", "id = 587", "`marker.id` is `587` (allowed: 0 to 586)"),
    (
        "side_m = 0.08",
        "side_m = inf",
        "`marker.side_m` is `inf` (allowed: a finite number above 0)",
    ),
    (
        "white_reflectance = 0.75",
        "white_reflectance = 1.2",
        "`marker.white_reflectance` is `1.2` (allowed: above 0",
    ),
    (
        "[0.25, 0.16, 0.043]",
        "[0.25, nan, 0.043]",
        "`ball.center_m` is `[0.25, NaN, 0.043]` (allowed: finite numbers)",
    ),
    (
        "radius_m = 0.038",
        "radius_m = -0.038",
        "`ball.radius_m` is `-0.038` (allowed: a finite number above 0)",
    ),
    (
        "[0.7, 0.69, 1.0]",
        "[0.0, 0.69, 1.0]",
        "`ball.reflectance` is `[0.0, 0.69, 1.0]` (allowed: three numbers",
    ),
    (
        "roughness = 0.02",
        "roughness = 2.0",
        "`ball.roughness` is `2.0` (allowed: 0 to 1)",
    ),
];

fn read(text: &str) -> Result<Rig, RigError> {
    Rig::from_toml(text, Path::new("rig.toml"))
}

/// The error, with its causes, of the rig with one piece of its text replaced.
fn error_of(old: &str, new: &str) -> String {
    assert!(RIG.contains(old), "`{old}` is not in the rig");
    let error = read(&RIG.replacen(old, new, 1)).expect_err("a broken rig");
    let mut message = error.to_string();
    let mut cause = error.source();
    while let Some(source) = cause {
        message += &format!(": {source}");
        cause = source.source();
    }
    message
}

#[test]
fn a_whole_rig_is_read() {
    let rig = support::rig();
    assert_eq!((rig.main_marker, rig.cameras.len(), rig.markers.len()), (0, 2, 5));
    let scene = rig.scene_camera();
    assert_eq!(
        (scene.name.as_str(), scene.role, scene.camera_from_world),
        ("scene", Role::Scene, None)
    );
    assert_eq!(scene.intrinsics.focal_px, DVec2::new(605.5, 605.0));
    let LensModel::BrownConrady { k1, k2, p1, p2, k3 } = scene.intrinsics.lens else {
        panic!("wrong lens")
    };
    assert_eq!([k1, k2, p1, p2, k3], [-0.062, 0.022, -0.0004, 0.0003, 0.0]);
    // Rows of the file are rows of the matrix: the first gives the common red.
    assert!((scene.photometry.color * DVec3::new(1.0, 2.0, 3.0)).abs_diff_eq(DVec3::new(0.9, 2.0, 2.9), 1e-12));
    let probe = rig.probe_camera().expect("a probe");
    assert_eq!((probe.role, rig.camera("probe")), (Role::Fisheye, Some(probe)));
    let LensModel::KannalaBrandt { max_angle_rad, .. } = probe.intrinsics.lens else {
        panic!("wrong lens")
    };
    assert!((max_angle_rad.to_degrees() - 92.5).abs() < 1e-12);
    assert!((probe.camera_from_world.expect("fixed").translation - DVec3::new(0.2, 0.0, -0.05)).length() < 1e-12);
    assert_eq!(rig.marker(0).map(|marker| marker.white_reflectance), Some(0.75));
    assert_eq!(rig.marker(1).map(|marker| marker.white_reflectance), Some(0.8));
    assert_eq!(rig.marker(7), None);
    assert_eq!(rig.ball.map(|ball| ball.reflectance), Some([0.7, 0.69, 1.0]));
}

#[test]
fn a_measured_response_curve_is_read() {
    let values: Vec<String> = (0..256).map(|code| format!("{:?}", f64::from(code) / 255.0)).collect();
    let rig = read(&RIG.replacen("\"srgb\"", &format!("[{}]", values.join(", ")), 1)).expect("a rig");
    assert_eq!(rig.scene_camera().photometry.response.linear_from_code(51), 0.2);
}

#[test]
fn a_response_curve_that_falls_is_refused_with_the_code() {
    let mut values: Vec<f64> = (0..256).map(|code| f64::from(code) / 255.0).collect();
    values[200] = 0.5;
    let message = error_of("\"srgb\"", &format!("{values:?}"));
    assert!(
        message
            .contains("line 20: `camera.photometry.response` is not a response curve: the response falls from `0.78")
            && message.contains("to `0.5` at code `200` (allowed: never decreasing)"),
        "{message}"
    );
}

#[test]
fn the_ball_may_be_left_out_with_a_fisheye_only() {
    let without_ball = &RIG[..RIG.find("[ball]").expect("a ball")];
    assert_eq!(read(without_ball).expect("a rig").ball, None);
    let ball_camera = without_ball.replacen("role = \"fisheye\"", "role = \"ball\"", 1);
    let error = read(&ball_camera).unwrap_err();
    assert_eq!(
        error.to_string(),
        "`rig.toml` has neither a `[ball]` nor a camera with role `fisheye`"
    );
    assert!(error.hint().is_some());
}

#[test]
fn a_rig_without_markers_is_refused() {
    let without = format!(
        "{}{}",
        &RIG[..RIG.find("[[marker]]").unwrap()],
        &RIG[RIG.find("[ball]").unwrap()..]
    );
    let error = read(&without).unwrap_err();
    assert_eq!(
        error.to_string(),
        "`rig.toml` has no marker (allowed: one `[[marker]]` or more)"
    );
    assert!(error.hint().is_some());
}

#[test]
fn unknown_and_missing_keys_are_named_with_their_line() {
    let message = error_of("side_m = 0.08", "side_mm = 80");
    assert!(
        message.starts_with("`rig.toml`, line 46: unknown field `side_mm`, expected one of `family`"),
        "{message}"
    );
    let message = error_of("full_well_e = 12000.0\n", "");
    assert!(message.contains("missing field `full_well_e`"), "{message}");
    let message = error_of("version = 1", "version = 1\nverison = 1");
    assert!(
        message.starts_with("`rig.toml`, line 2: unknown field `verison`"),
        "{message}"
    );
    let message = error_of("version = 1", "version = [");
    assert!(message.starts_with("`rig.toml`, line "), "{message}");
    let message = error_of("\"srgb\"", "7");
    assert!(
        message.contains("`response` must be \"srgb\" or a list of 256 numbers"),
        "{message}"
    );
}

#[test]
fn values_out_of_range_are_named_with_what_is_allowed() {
    for (old, new, expected) in OUT_OF_RANGE {
        let message = error_of(old, new);
        assert!(
            message.starts_with("`rig.toml`, line ") && message.contains(expected),
            "{new}: {message}"
        );
    }
}

#[test]
fn broken_poses_and_curves_are_named() {
    let message = error_of("[1.0, 0.0, 0.0, 0.11]", "[nan, 0.0, 0.0, 0.11]");
    assert_eq!(
        message,
        "`rig.toml`, line 54: `marker.world_from_marker` is not a pose: element `NaN` in row `0`, column `0` is not a finite \
         number"
    );
    let message = error_of("[[1.0, 0.0, 0.0, 0.2]", "[[2.0, 0.0, 0.0, 0.2]");
    assert!(
        message.contains("`camera.camera_from_world` is not a pose: the 3×3 block is no rotation"),
        "{message}"
    );
    let message = error_of("\"srgb\"", "[0.0, 1.0]");
    assert!(
        message.contains("is not a response curve: the response curve has `2` values"),
        "{message}"
    );
}

#[test]
fn the_lens_model_must_be_known_and_complete() {
    let message = error_of("\"brown_conrady\"", "\"opencv5\"");
    assert_eq!(
        message,
        "`rig.toml`, line 10: unknown camera model `opencv5` (allowed: `brown_conrady`, `rational`, `kannala_brandt`, \
         `equisolid`, `eucm`, `double_sphere`)"
    );
    let message = error_of("max_angle_deg = 92.5\n", "");
    assert!(
        message.contains("camera model `kannala_brandt` needs `max_angle_deg`"),
        "{message}"
    );
    let message = error_of("0.0003, 0.0]", "0.0003, 0.0]\nmax_angle_deg = 40");
    assert!(
        message.contains(
            "`camera.lens.max_angle_deg` is `40.0` (allowed: with `kannala_brandt`, `equisolid`, `eucm` and "
        ),
        "{message}"
    );
}

#[test]
fn cameras_and_markers_must_fit_together() {
    let cases = [
        (
            "role = \"scene\"",
            "role = \"ball\"",
            "camera `scene` is fixed: it needs `camera_from_world`",
        ),
        (
            "role = \"fisheye\"",
            "role = \"scene\"",
            "camera `probe` has role `scene` and so moves: leave out",
        ),
        (
            "name = \"probe\"",
            "name = \"scene\"",
            "line 24: camera `scene` is there twice (allowed: once)",
        ),
        ("id = 2", "id = 1", "line 58: marker `1` is there twice (allowed: once)"),
        (
            "main_marker = 0",
            "main_marker = 9",
            "`main_marker` is `9`, but no `[[marker]]` has that id (there are: `0`, `1`",
        ),
        (
            "main_marker = 0",
            "main_marker = 1",
            "line 54: `world_from_marker` of the main marker `1` is not the identity",
        ),
    ];
    for (old, new, expected) in cases {
        let message = error_of(old, new);
        assert!(message.contains(expected), "{new}: {message}");
    }
    let from = RIG.find("[[camera]]\nname = \"scene\"").unwrap();
    let to = RIG.find("[[camera]]\nname = \"probe\"").unwrap();
    let error = read(&format!("{}{}", &RIG[..from], &RIG[to..])).unwrap_err();
    assert_eq!(
        error.to_string(),
        "`rig.toml` has 0 cameras with role `scene` (allowed: exactly 1)"
    );
    let probe = &RIG[to..RIG.find("[[marker]]").unwrap()];
    let films_the_ball = probe.replace("probe", "other").replace("\"fisheye\"", "\"ball\"");
    let without_ball = &RIG[..RIG.find("[ball]").expect("the rig has a ball")];
    let error = read(&without_ball.replacen("[[marker]]", &format!("{films_the_ball}\n[[marker]]"), 1)).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("camera `other` films the ball: describe it in `[ball]`"),
        "{error}"
    );
}

#[test]
fn several_cameras_may_film_the_light() {
    let from = RIG.find("[[camera]]\nname = \"probe\"").expect("a probe");
    let probe = &RIG[from..RIG.find("[[marker]]").expect("a marker")];
    let more = format!(
        "{}\n{}\n[[marker]]",
        probe.replace("probe", "second").replace("\"fisheye\"", "\"ball\""),
        probe.replace("probe", "third")
    );
    let rig = read(&RIG.replacen("[[marker]]", &more, 1)).expect("any number of fixed cameras");
    let names: Vec<&str> = rig.probe_cameras().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["probe", "second", "third"]);
    assert_eq!(rig.probe_camera().map(|camera| camera.name.as_str()), Some("probe"));
}

/// The test's rig with another lens for the probe camera.
fn with_probe_lens(model: &str, distortion: &str, angle: &str) -> Result<Rig, RigError> {
    let from = RIG.find("model = \"kannala_brandt\"").expect("a fisheye");
    let rest = &RIG[from..];
    let end = from + rest.find("\n\n").expect("tables are set apart");
    let kept: String = RIG[from..end]
        .lines()
        .filter(|line| line.starts_with("focal_px") || line.starts_with("principal_point_px"))
        .map(|line| format!("{line}\n"))
        .collect();
    read(&format!(
        "{}model = \"{model}\"\n{kept}distortion = {distortion}\n{angle}\n{}",
        &RIG[..from],
        &RIG[end..]
    ))
}

#[test]
fn every_lens_model_is_read_and_written() {
    let angle = "max_angle_deg = 92.5";
    let max_angle_rad = 92.5f64.to_radians();
    let coefficients = [0.8, 0.06, 0.001, -0.0007, 0.004, 1.05, 0.09, 0.006];
    let written = "[0.8, 0.06, 0.001, -0.0007, 0.004, 1.05, 0.09, 0.006]";
    let eucm = |max_angle_rad| LensModel::Eucm {
        alpha: 0.62,
        beta: 1.1,
        max_angle_rad,
    };
    let spheres = |max_angle_rad| LensModel::DoubleSphere {
        xi: -0.2,
        alpha: 0.6,
        max_angle_rad,
    };
    for (model, distortion, angle, expected) in [
        ("rational", written, "", LensModel::Rational { coefficients }),
        ("equisolid", "[]", angle, LensModel::Equisolid { max_angle_rad }),
        ("eucm", "[0.62, 1.1]", "", eucm(PI)),
        ("eucm", "[0.62, 1.1]", angle, eucm(max_angle_rad)),
        ("double_sphere", "[-0.2, 0.6]", "", spheres(PI)),
        ("double_sphere", "[-0.2, 0.6]", angle, spheres(max_angle_rad)),
    ] {
        let rig = with_probe_lens(model, distortion, angle).expect("a good lens");
        let intrinsics = rig.camera("probe").expect("a probe").intrinsics;
        assert_eq!(intrinsics.lens, expected);
        let mut draft = RigDraft::from_toml(RIG, Path::new("rig.toml")).expect("a good rig");
        draft.set_lens("probe", &intrinsics);
        let back = draft.parts(Path::new("rig.toml")).expect("a good rig");
        let back = back.camera("probe").expect("a probe").intrinsics.expect("a lens");
        assert_eq!(back.parameters(), intrinsics.parameters());
        let apart = back.lens.max_angle_rad().unwrap_or(0.0) - intrinsics.lens.max_angle_rad().unwrap_or(0.0);
        assert!(apart.abs() < 1e-12, "{apart}");
    }
}

#[test]
fn lenses_that_make_no_sense_are_refused() {
    let angle = "max_angle_deg = 92.5";
    for (model, distortion, angle, message) in [
        ("equisolid", "[0.1]", angle, "an empty list"),
        ("equisolid", "[]", "", "camera model `equisolid` needs `max_angle_deg`"),
        ("equisolid", "[]", "max_angle_deg = 180.0", "above 0, below 180"),
        ("rational", "[0.1, 0.0, 0.0, 0.0, 0.0]", "", "eight finite numbers"),
        ("rational", "[0.0, 0.0, 0.4, 0.0, 0.0, 0.1, 0.0, 0.0]", "", "one to one"),
        (
            "rational",
            "[0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0]",
            angle,
            "is `92.5` (allowed: with",
        ),
        ("eucm", "[0.6]", "", "two finite numbers: alpha, beta"),
        ("eucm", "[0.6, 0.0]", "", "one to one"),
        ("double_sphere", "[0.6, nan]", "", "two finite numbers: xi, alpha"),
        ("double_sphere", "[-1.0, 0.6]", "", "one to one"),
        (
            "double_sphere",
            "[-0.1, 0.6]",
            "max_angle_deg = 181",
            "above 0, at most 180",
        ),
        (
            "fov",
            "[0.9]",
            "",
            "unknown camera model `fov` (allowed: `brown_conrady`, `rational`,",
        ),
    ] {
        let error = with_probe_lens(model, distortion, angle).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_text_is_answered(text in ".{0,200}") {
        let _ = read(&text);
    }

    #[test]
    fn a_damaged_rig_is_answered(at in 0..RIG.len(), length in 0usize..40, put in "[-0-9a-z\\[\\]=\". \\n]{0,12}") {
        let end = (at + length).min(RIG.len());
        if let (Some(before), Some(after)) = (RIG.get(..at), RIG.get(end..)) {
            let _ = read(&format!("{before}{put}{after}"));
        }
    }
}
