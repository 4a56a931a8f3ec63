//! Files of other programs: real ones, round trips, and what is refused.

use glam::{DVec2, DVec3};
use proptest::prelude::*;

use super::*;
use crate::pose::Twist;

/// As OpenCV 4's calibration sample writes it.
const OPENCV: &str = "%YAML:1.0
---
calibration_time: \"Fri Nov 27 20:00:00 2026\"
nr_of_frames: 23
image_width: 640
image_height: 480
board_width: 9
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.0550000000000000e+02, 0., 3.2089999999999998e+02, 0.,
       604., 2.3840000000000001e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.0000000000000001e-01, -2.0000000000000001e-01, 1e-03,
       -7.0000000000000000e-04, 4.0000000000000001e-03 ]
avg_reprojection_error: 1.6700000000000001e-01
";

/// As OpenCV 5 writes a vector.
const OPENCV_5: &str = "%YAML 1.2
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 605.5, 0., 320.89999999999998, 0., 604., 238.40000000000001,
       0., 0., 1. ]
distortion_coefficients: !!opencv-nd-matrix
   sizes: [ 14 ]
   dt: d
   data: [ 0.8, 0.06, 0.001, -0.0007, 0.004, 1.05, 0.09, 0.006, 0., 0.,
       0., 0., 0., 0. ]
";

/// As `camera_calibration_parsers` writes it.
const ROS: &str = "image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [369.40269, 0, 310.549287, 0, 371.158263, 230.099198, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.331914, 0.068294, -0.00294, 0.004949, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [239.825516, 0, 320.12496, 0, 0, 302.331085, 220.692742, 0, 0, 0, 1, 0]
";

/// As Kalibr's wiki shows it, with other lenses added.
const KALIBR: &str = "cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [ 0.99998854, 0.00216014, 0.00427195,-0.11003785]
  - [-0.00221074, 0.99992702, 0.01187697, 0.00045792]
  - [-0.00424598,-0.01188627, 0.99992034,-0.00064487]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.19963086, 0.592459, 317.5525, 316.1745, 724.8551, 546.5708]
  resolution: [1440, 1080]
cam2:
  camera_model: eucm
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [0.62, 1.1, 460.0, 461.0, 363.0, 247.0]
  resolution: [752, 480]
cam10:
  camera_model: pinhole
  distortion_coeffs: [-0.0121, 0.0058, -0.0021, 0.00021]
  distortion_model: equidistant
  intrinsics: [190.0, 191.0, 363.0, 247.0]
  resolution: [752, 480]
";

fn read(text: &str) -> Result<Vec<ForeignCamera>, InterchangeError> {
    Format::of(text)
        .expect("a known format")
        .read(text, Path::new("file.yaml"))
}

#[test]
fn a_file_of_opencv_is_read() {
    assert_eq!(Format::of(OPENCV), Some(Format::Opencv));
    let [camera] = &read(OPENCV).unwrap()[..] else {
        panic!("one camera")
    };
    assert_eq!(camera.intrinsics.size_px, [640, 480]);
    let expected = [605.5, 604.0, 320.9, 238.4, 0.1, -0.2, 1e-3, -7e-4, 0.004];
    assert_eq!(camera.intrinsics.parameters(), expected);
    assert_eq!(camera.intrinsics.lens.model(), Model::BrownConrady);
    let fourteen = read(OPENCV_5).unwrap()[0].intrinsics.lens;
    let coefficients = [0.8, 0.06, 0.001, -0.0007, 0.004, 1.05, 0.09, 0.006];
    assert_eq!(fourteen, LensModel::Rational { coefficients });
}

#[test]
fn a_fisheye_of_opencv_is_marked() {
    let four = "data: [ -0.0121, 0.0058, -0.0021, 0.00021 ]\navg";
    let from = OPENCV.find("data: [ 1.0000000000000001e-01").unwrap();
    let text = format!(
        "{}{four}{}",
        &OPENCV[..from],
        &OPENCV[OPENCV.find("avg").unwrap() + 3..]
    );
    assert_eq!(read(&text).unwrap()[0].intrinsics.lens.model(), Model::BrownConrady);
    let marks = [
        ("fisheye_model: 0", "fisheye_model: 1"),
        ("fisheye_model: 0", "distortion_model: equidistant"),
    ];
    for (from, to) in marks {
        let lens = read(&text.replace(from, to)).unwrap()[0].intrinsics.lens;
        assert_eq!(lens.coefficients(), [-0.0121, 0.0058, -0.0021, 0.00021]);
        assert_eq!(lens.model(), Model::KannalaBrandt);
        // The farthest corner is 0.66 focal lengths away, where the lens sees 38 degrees off its axis.
        let end = lens.max_angle_rad().unwrap().to_degrees();
        assert!((37.0..39.0).contains(&end), "{end}");
    }
}

#[test]
fn a_file_of_ros_is_read() {
    assert_eq!(Format::of(ROS), Some(Format::Ros));
    let [camera] = &read(ROS).unwrap()[..] else {
        panic!("one camera")
    };
    assert_eq!(camera.name, "narrow_stereo");
    let expected = [
        369.402_69,
        371.158_263,
        310.549_287,
        230.099_198,
        -0.331_914,
        0.068_294,
        -0.002_94,
        0.004_949,
        0.0,
    ];
    assert_eq!(camera.intrinsics.parameters(), expected);
    let eight = ROS
        .replace("plumb_bob", "rational_polynomial")
        .replace("0.004949, 0]", "0.004949, 0, 0.1, 0.02, 0]");
    assert_eq!(read(&eight).unwrap()[0].intrinsics.lens.model(), Model::Rational);
    let four = ROS
        .replace("plumb_bob", "equidistant")
        .replace("0.004949, 0]", "0.004949]");
    assert_eq!(read(&four).unwrap()[0].intrinsics.lens.model(), Model::KannalaBrandt);
}

#[test]
fn a_chain_of_kalibr_is_read() {
    assert_eq!(Format::of(KALIBR), Some(Format::Kalibr));
    let cameras = read(KALIBR).unwrap();
    let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["cam0", "cam1", "cam2", "cam10"]);
    let expected = [
        461.629,
        460.152,
        362.680,
        246.049,
        -0.276_954_97,
        0.067_124_82,
        0.000_875_38,
        0.000_115_56,
        0.0,
    ];
    assert_eq!(cameras[0].intrinsics.parameters(), expected);
    let expected = [317.5525, 316.1745, 724.8551, 546.5708, -0.199_630_86, 0.592_459];
    assert_eq!(cameras[1].intrinsics.parameters(), expected);
    assert_eq!(cameras[2].intrinsics.lens.coefficients(), [0.62, 1.1]);
    assert_eq!(cameras[3].intrinsics.lens.model(), Model::KannalaBrandt);
    assert_eq!(cameras[0].camera_from_previous, None);
    let place = cameras[1].camera_from_previous.unwrap().translation;
    assert_eq!(place, DVec3::new(-0.110_037_85, 0.000_457_92, -0.000_644_87));
}

#[test]
fn what_cannot_be_read_is_named_with_its_line() {
    let chain = |from: &str, to: &str| (KALIBR.replacen(from, to, 1), Format::Kalibr);
    let ros = |from: &str, to: &str| (ROS.replacen(from, to, 1), Format::Ros);
    let opencv = |from: &str, to: &str| (OPENCV.replacen(from, to, 1), Format::Opencv);
    let cases = [
        (
            chain("camera_model: pinhole", "camera_model: omni"),
            "`file.yaml`, line 3: the camera model `omni-radtan` is not supported (allowed: pinhole-radtan, pinhole-equi",
        ),
        (
            chain("radtan", "fov"),
            "line 3: the camera model `pinhole-fov` is not supported",
        ),
        (chain("  resolution: [752, 480]\n", ""), "missing field `resolution`"),
        (
            chain(", 0.00011556]", "]"),
            "line 4: `distortion_coeffs` is `[-0.27695497, 0.06712482, 0.00087538]`",
        ),
        (
            chain(", 246.049]", "]"),
            "line 6: `intrinsics` is `[461.629, 460.152, 362.68]` (allowed: fu, fv, pu, pv)",
        ),
        (chain("[461.629", "[-461.629"), "focal lengths above 0"),
        (
            chain("[752, 480]", "[0, 480]"),
            "line 7: `resolution` is `0` (allowed: 1 to 16384)",
        ),
        (chain("0.99998854", "0.9"), "`T_cn_cnm1` is not a pose"),
        (
            chain("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 2.0]"),
            "`T_cn_cnm1` is `[0.0, 0.0, 0.0, 2.0]`",
        ),
        (
            chain("[-0.19963086", "[-1.5"),
            "a distortion that maps rays to pixels one to one",
        ),
        (
            ros("plumb_bob", "thin_prism"),
            "line 8: the camera model `thin_prism` is not supported (allowed: `plumb_bob`",
        ),
        (
            ros("0.004949, 0]", "0.004949, 0, 1]"),
            "`distortion_coefficients` is `[-0.331914",
        ),
        (
            ros("plumb_bob", "equidistant"),
            "(allowed: finite numbers: k1, k2, k3, k4)",
        ),
        (ros("310.549287", ".nan"), "line 5: `camera_matrix` is"),
        (ros("image_width: 640\n", ""), "missing field `image_width`"),
        (
            ros("data: [369.40269, 0,", "data: [369.40269, 0.1,"),
            "(allowed: fx 0 cx, 0 fy cy, 0 0 1",
        ),
        (opencv("camera_matrix", "camera"), "missing field `camera_matrix`"),
        (opencv("[ 1.0000000000000001e-01", "[ text"), "line 1"),
    ];
    for ((text, format), expected) in cases {
        let error = format.read(&text, Path::new("file.yaml")).unwrap_err();
        let said = error.to_string();
        assert!(
            said.contains(expected) && said.starts_with("`file.yaml`, line "),
            "{said}\n{expected}"
        );
    }
}

#[test]
fn other_texts_are_no_format() {
    for text in ["", "version = 1\n[[camera]]\n", "a: 1\n", "\u{0}"] {
        assert_eq!(Format::of(text), None, "{text}");
    }
}

#[test]
fn what_a_format_has_no_words_for_is_refused() {
    let camera = |lens| ForeignCamera {
        name: "left".to_owned(),
        intrinsics: Intrinsics {
            lens,
            ..pinhole([640, 480], [600.0, 600.0, 320.0, 240.0])
        },
        camera_from_previous: None,
    };
    let eucm = camera(LensModel::Eucm {
        alpha: 0.6,
        beta: 1.1,
        max_angle_rad: PI,
    });
    assert_eq!(
        Format::Opencv.write(&[eucm]).unwrap_err().to_string(),
        "camera `left`: a file of OpenCV cannot hold the model `eucm` (allowed: `brown_conrady`, `rational`, `kannala_brandt`)"
    );
    let long = LensModel::BrownConrady {
        k1: 0.1,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.2,
    };
    let said = Format::Kalibr.write(&[camera(long)]).unwrap_err().to_string();
    assert!(said.contains("`k3` of `0.2`"), "{said}");
    let rational = camera(LensModel::Rational { coefficients: [0.0; 8] });
    assert!(Format::Kalibr.write(std::slice::from_ref(&rational)).is_err());
    assert!(Format::Ros.write(&[rational.clone(), rational]).is_err());
    assert!(Format::Kalibr.write(&[]).is_err());
}

fn lens() -> impl Strategy<Value = LensModel> {
    let small = || -0.01f64..0.01;
    prop_oneof![
        (-0.2f64..0.2, -0.05f64..0.1, small(), small(), small())
            .prop_map(|(k1, k2, p1, p2, k3)| LensModel::BrownConrady { k1, k2, p1, p2, k3 }),
        (prop::array::uniform8(-0.002f64..0.002)).prop_map(|coefficients| LensModel::Rational { coefficients }),
        prop::array::uniform4(small()).prop_map(|k| LensModel::KannalaBrandt { k, max_angle_rad: 1.0 }),
        (0.0f64..1.0, 0.5f64..2.0).prop_map(|(alpha, beta)| LensModel::Eucm {
            alpha,
            beta,
            max_angle_rad: PI
        }),
        (-0.9f64..0.9, 0.0f64..1.0).prop_map(|(xi, alpha)| LensModel::DoubleSphere {
            xi,
            alpha,
            max_angle_rad: PI
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_written_is_read_back(
        lens in lens(), focal in (50.0f64..3000.0, 50.0f64..3000.0), centre in (0.0f64..640.0, -1e-7f64..480.0),
        turn in prop::array::uniform3(-1.0f64..1.0), place in prop::array::uniform3(-1e-6f64..2.0),
    ) {
        let camera = ForeignCamera {
            name: "left".to_owned(),
            intrinsics: Intrinsics { lens, ..pinhole([640, 480], [focal.0, focal.1, centre.0, centre.1]) },
            camera_from_previous: None,
        };
        prop_assume!(lens.is_usable());
        for format in Format::ALL {
            // Kalibr has no k3.
            let mut camera = camera.clone();
            if let (Format::Kalibr, LensModel::BrownConrady { k3, .. }) = (format, &mut camera.intrinsics.lens) {
                *k3 = 0.0;
            }
            if !format.models().contains(&lens.model()) || !camera.intrinsics.lens.is_usable() {
                continue;
            }
            let text = format.write(std::slice::from_ref(&camera)).expect("a model that it has words for");
            prop_assert_eq!(Format::of(&text), Some(format));
            let back = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            prop_assert_eq!(back.len(), 1);
            prop_assert_eq!(back[0].intrinsics.lens.model(), lens.model());
            prop_assert_eq!(back[0].intrinsics.parameters(), camera.intrinsics.parameters());
            prop_assert_eq!(back[0].intrinsics.size_px, [640, 480]);
        }
        if Format::Kalibr.models().contains(&lens.model()) && lens.model() != Model::BrownConrady {
            let pose = Pose::exp(Twist { rotation: DVec3::from(turn), translation: DVec3::from(place) });
            let second = ForeignCamera { camera_from_previous: Some(pose), ..camera.clone() };
            let text = Format::Kalibr.write(&[camera, second]).expect("a chain");
            let back = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            let apart = back[1].camera_from_previous.expect("written") * pose.inverse();
            prop_assert!(apart.translation.length() + apart.angle_to(&Pose::identity()) < 1e-12);
        }
    }

    #[test]
    fn any_text_is_answered(text in ".{0,200}", at in 0..KALIBR.len(), put in "[-0-9a-z\\[\\]:{}&*!. \\n]{0,12}") {
        for format in Format::ALL {
            let _ = format.read(&text, Path::new("file.yaml"));
            for sample in [OPENCV, ROS, KALIBR] {
                let at = at.min(sample.len());
                let _ = format.read(&format!("{}{put}{}", &sample[..at], &sample[at..]), Path::new("file.yaml"));
            }
        }
    }

    #[test]
    fn a_fisheye_that_is_read_is_usable_to_its_end(k in prop::array::uniform4(-0.05f64..0.05), focal in 50.0f64..800.0) {
        let bare = pinhole([640, 480], [focal, focal, 320.0, 240.0]);
        let max_angle_rad = end_of_picture(&bare, k);
        let lens = LensModel::KannalaBrandt { k, max_angle_rad };
        prop_assert!(lens.is_usable(), "{lens:?}");
        // It ends at the corner or where the polynomial ends: 0.2 degrees further it is past one of the two.
        let further = LensModel::KannalaBrandt { k, max_angle_rad: max_angle_rad + 0.2f64.to_radians() };
        let corner = DVec2::new(-0.5, -0.5);
        let sees = |lens| Intrinsics { lens, ..bare }.unproject(corner).is_some();
        prop_assert!(sees(lens) || !further.is_usable(), "{lens:?}");
    }
}

#[test]
fn numbers_are_those_of_yaml_1_1_too() {
    for (value, text) in [
        (1e-5, "1.0e-5"),
        (1.5e20, "1.5e+20"),
        (1e300, "1.0e+300"),
        (605.5, "605.5"),
        (-2.0, "-2.0"),
    ] {
        assert_eq!(number(value), text);
        assert_eq!(text.parse(), Ok(value));
    }
}
