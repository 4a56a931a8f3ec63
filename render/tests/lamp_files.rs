//! Virtual lamps in scene files and in glTF files.

mod support;

use std::f32::consts::PI;
use std::path::{Path, PathBuf};

use glam::Vec3;
use mirrorball_render::error::RenderError;
use mirrorball_render::scene::{Carrier, LampKind, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;

/// A triangle in a node that stands 1 m up, with a spot light beside it that its own node turns to shine along +y.
const GLTF: &str = r#"{
  "asset": {"version": "2.0"},
  "extensionsUsed": ["KHR_lights_punctual"],
  "extensions": {"KHR_lights_punctual": {"lights": [
    {"type": "spot", "intensity": 50.0, "color": [1.0, 0.5, 0.0], "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.3}},
    {"type": "directional", "intensity": 300.0},
    {"type": "point", "intensity": 0.0}
  ]}},
  "scene": 0,
  "scenes": [{"nodes": [0, 2, 3]}],
  "nodes": [
    {"name": "shell", "mesh": 0, "translation": [0, 0, 1], "scale": [2, 2, 2], "children": [1]},
    {"name": "bulb", "translation": [0, 0.5, 0], "rotation": [0.70710678, 0, 0, 0.70710678],
     "extensions": {"KHR_lights_punctual": {"light": 0}}},
    {"name": "sun", "extensions": {"KHR_lights_punctual": {"light": 1}}},
    {"name": "off", "extensions": {"KHR_lights_punctual": {"light": 2}}}
  ],
  "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
  "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
  "bufferViews": [{"buffer": 0, "byteLength": 36}],
  "buffers": [{"byteLength": 36,
    "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]
}"#;

const OBJECT: &str = "[[object]]\nname = \"shade\"\nkind = \"virtual\"\nmesh = \"lamp.gltf\"\nmesh_up = \"z\"\n";

/// Writes a scene file with the glTF file beside it.
fn written(folder: &Path, text: &str) -> PathBuf {
    std::fs::write(folder.join("lamp.gltf"), GLTF).expect("a folder of our own");
    let file = folder.join("scene.toml");
    std::fs::write(&file, text).expect("a folder of our own");
    file
}

fn load(text: &str) -> Result<Scene, RenderError> {
    let folder = tempfile::tempdir().expect("a folder of our own");
    Scene::load(&written(folder.path(), text), &support::rig())
}

#[test]
fn lamps_of_a_scene_file_are_what_it_says() {
    let scene = load(&format!(
        "version = 1\n{OBJECT}
        [[lamp]]
        name = \"desk\"
        kind = \"spot\"
        white_radiance = 0.5
        color = [1.0, 0.8, 0.6]
        position_m = [0.1, 0.2, 0.3]
        direction = [0.0, 0.0, -2.0]
        inner_deg = 10.0
        outer_deg = 30.0
        radius_m = 0.02
        marker = 1
        [[lamp]]
        name = \"panel\"
        kind = \"rectangle\"
        white_radiance = 1.0
        half_size_m = [0.3, 0.1]
        across = [1.0, 0.0, 0.5]
        object = \"shade\"
        "
    ))
    .unwrap();
    assert_eq!(
        scene.lamps.len(),
        4,
        "two of the file, two lights of the glTF file that shine"
    );
    let [desk, panel] = [&scene.lamps[0], &scene.lamps[1]];
    assert!(desk.irradiance.distance(0.5 * PI * Vec3::new(1.0, 0.8, 0.6)) < 1e-6);
    assert_eq!((desk.carrier, desk.direction), (Carrier::Marker(1), Vec3::NEG_Z));
    let LampKind::Spot {
        radius_m,
        inner_rad,
        outer_rad,
    } = desk.kind
    else {
        panic!("{:?}", desk.kind)
    };
    assert!(radius_m == 0.02 && (inner_rad - PI / 18.0).abs() < 1e-6 && (outer_rad - PI / 6.0).abs() < 1e-6);
    assert_eq!(panel.kind, LampKind::Rectangle { half_m: [0.3, 0.1] });
    assert_eq!((panel.carrier, panel.across), (Carrier::Object(0), Vec3::X));
}

#[test]
fn lights_of_gltf_files_become_lamps_on_the_object() {
    let scene = load(&format!("version = 1\nradiance_per_nit = 0.02\n{OBJECT}")).unwrap();
    let [spot, sun] = &scene.lamps[..] else {
        panic!("{:?}", scene.lamps)
    };
    assert_eq!((spot.name.as_str(), spot.carrier), ("shade/bulb", Carrier::Object(0)));
    // The parent's scale moves the light and does not change it.
    assert!(spot.position_m.distance(Vec3::new(0.0, 1.0, 1.0)) < 1e-5, "{spot:?}");
    assert!(spot.direction.distance(Vec3::Y) < 1e-5, "{spot:?}");
    assert!(
        spot.irradiance.distance(Vec3::new(1.0, 0.5, 0.0)) < 1e-5,
        "50 cd at 0.02 per cd/m²: {spot:?}"
    );
    assert!(matches!(spot.kind, LampKind::Spot { inner_rad, outer_rad, .. } if inner_rad == 0.1 && outer_rad == 0.3));
    assert!(
        sun.irradiance.distance(Vec3::splat(6.0)) < 1e-5 && sun.direction == Vec3::NEG_Z,
        "{sun:?}"
    );
}

#[test]
fn lights_of_gltf_files_go_with_the_node_and_the_scale_of_their_object() {
    let scene = load(&format!("version = 1\n{OBJECT}scale = 0.1\nnode = \"shell\"\n")).unwrap();
    let [spot] = &scene.lamps[..] else {
        panic!("the sun is not below the node: {:?}", scene.lamps)
    };
    assert!(spot.position_m.distance(Vec3::new(0.0, 0.1, 0.1)) < 1e-6, "{spot:?}");
    assert!(
        spot.irradiance.distance(Vec3::new(0.5, 0.25, 0.0)) < 1e-5,
        "50 cd, whatever the scale: {spot:?}"
    );
}

#[test]
fn lamps_that_cannot_be_are_refused_by_name_and_key() {
    let cases = [
        ("kind = \"point\"\nwhite_radiance = 0.0", "white_radiance"),
        (
            "kind = \"point\"\nwhite_radiance = 1.0\ncolor = [-1.0, 1.0, 1.0]",
            "color",
        ),
        (
            "kind = \"point\"\nwhite_radiance = 1.0\ncolor = [1.0e38, 1.0, 1.0]",
            "color",
        ),
        (
            "kind = \"point\"\nwhite_radiance = 1.0\ncolor = [0.0, 0.0, 0.0]",
            "color",
        ),
        ("kind = \"point\"\nwhite_radiance = 1.0\nradius_m = -0.1", "radius_m"),
        (
            "kind = \"directional\"\nwhite_radiance = 1.0\nposition_m = [0.0, 0.0, 1.0]",
            "position_m",
        ),
        (
            "kind = \"point\"\nwhite_radiance = 1.0\nposition_m = [nan, 0.0, 0.0]",
            "position_m",
        ),
        ("kind = \"point\"\nwhite_radiance = 1.0\nouter_deg = 20.0", "outer_deg"),
        (
            "kind = \"spot\"\nwhite_radiance = 1.0\ninner_deg = 50.0\nouter_deg = 40.0",
            "inner_deg",
        ),
        (
            "kind = \"spot\"\nwhite_radiance = 1.0\ndirection = [0.0, 0.0, 0.0]",
            "direction",
        ),
        (
            "kind = \"directional\"\nwhite_radiance = 1.0\nangular_radius_deg = 60.0",
            "angular_radius_deg",
        ),
        ("kind = \"rectangle\"\nwhite_radiance = 1.0", "half_size_m"),
        (
            "kind = \"rectangle\"\nwhite_radiance = 1.0\nhalf_size_m = [0.1, 0.0]",
            "half_size_m",
        ),
        (
            "kind = \"rectangle\"\nwhite_radiance = 1.0\nhalf_size_m = [0.1, 0.1]\nacross = [0.0, 0.0, 1.0]",
            "across",
        ),
        ("kind = \"point\"\nwhite_radiance = 1.0\nmarker = 99", "marker"),
        ("kind = \"point\"\nwhite_radiance = 1.0\nobject = \"nobody\"", "object"),
        (
            "kind = \"point\"\nwhite_radiance = 1.0\nobject = \"shade\"\nmarker = 0",
            "object",
        ),
    ];
    for (keys, expected) in cases {
        let error = load(&format!("version = 1\n{OBJECT}[[lamp]]\nname = \"desk\"\n{keys}\n")).unwrap_err();
        let RenderError::Lamp { lamp, field, .. } = &error else {
            panic!("{keys}: {error}")
        };
        assert_eq!((lamp.as_str(), *field), ("desk", expected), "{error}");
        assert!(error.is_bad_input() && error.hint().is_some());
    }
}

#[test]
fn names_units_and_carriers_of_lamps_that_cannot_be_are_named() {
    let twice = "[[lamp]]\nname = \"desk\"\nkind = \"point\"\nwhite_radiance = 1.0\n";
    let error = load(&format!("version = 1\n{twice}{twice}")).unwrap_err();
    assert!(error.to_string().contains("`desk`, `name`"), "{error}");
    for value in ["0.0", "1e38", "inf", "nan"] {
        let error = load(&format!("version = 1\nradiance_per_nit = {value}\n")).unwrap_err();
        assert!(error.to_string().contains("`radiance_per_nit` is "), "{error}");
    }
    for (keys, expected) in [
        ("marker = 99", "the rig has no marker `99`; it has `0`, `1`"),
        (
            "object = \"nobody\"",
            "the scene has no object `nobody`; it has `shade`",
        ),
    ] {
        let lamp = "[[lamp]]\nname = \"desk\"\nkind = \"point\"\nwhite_radiance = 1.0\n";
        let error = load(&format!("version = 1\n{OBJECT}{lamp}{keys}\n")).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn more_lamps_than_are_drawn_are_refused() {
    let lamps = |n: usize| -> String {
        let lamp = |i| format!("[[lamp]]\nname = \"{i}\"\nkind = \"point\"\nwhite_radiance = 1.0\n");
        (0..n).map(lamp).collect()
    };
    let error = load(&format!("version = 1\n{}", lamps(9))).unwrap_err();
    assert!(
        error.to_string().contains("scene.toml`: the scene has 9 virtual lamps"),
        "{error}"
    );
    let mut scene = load(&format!("version = 1\n{}", lamps(8))).unwrap();
    scene.lamps.push(scene.lamps[0].clone());
    let Some(gpu) = support::gpu() else { return };
    let error = SceneBuffers::new(&gpu, &scene, &support::rig()).unwrap_err();
    assert!(
        matches!(error, RenderError::TooManyLamps { found: 9, limit: 8 }),
        "{error}"
    );
}
