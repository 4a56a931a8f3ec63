//! Every file in `configs/` and every carried rig and scene is read by the code that it is for.

use std::path::{Path, PathBuf};

use crate::support::data;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::{CaptureConfig, Pace, Player, Repeat};
use mirrorball_render::config::RenderConfig;
use mirrorball_render::scene::Scene;

fn configs() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../configs"))
}

fn rig(file: &Path) -> Rig {
    Rig::from_toml(&std::fs::read_to_string(file).unwrap(), file).unwrap()
}

#[test]
fn render_toml_spells_out_the_defaults() {
    assert_eq!(
        RenderConfig::load(&configs().join("render.toml")).unwrap(),
        RenderConfig::default()
    );
}

#[test]
fn settings_of_other_ways_of_lighting_are_read() {
    for entry in std::fs::read_dir(configs().join("peers")).unwrap() {
        let file = entry.unwrap().path();
        assert_ne!(
            RenderConfig::load(&file).unwrap(),
            RenderConfig::default(),
            "{}",
            file.display()
        );
    }
}

#[test]
fn capture_toml_spells_out_the_defaults() {
    let file = configs().join("capture.toml");
    let spelt_out = CaptureConfig::load(&file).unwrap();
    let camera = |name: &str, port: u32| {
        format!(
            "[[camera]]\nname = \"{name}\"\nrole = \"{name}\"\nsize_px = [1280, 720]\ncard = \"HD Pro Webcam\"\n\
             usb_path = \"usb-0000:00:14.0-{port}\"\n"
        )
    };
    let least = format!("version = 1\n{}{}", camera("scene", 1), camera("ball", 2));
    assert_eq!(spelt_out, CaptureConfig::parse(&least, &file).unwrap());
}

#[test]
fn what_is_commented_out_in_capture_toml_is_right_too() {
    let file = configs().join("capture.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let is_toml = |line: &str| line.starts_with('[') || line.contains(" = ");
    let uncommented = |line: &str| match line.strip_prefix("# ") {
        Some(rest) if is_toml(rest) && !rest.contains(": ") => rest.to_owned(),
        _ => line.to_owned(),
    };
    let text: Vec<String> = text.lines().map(uncommented).collect();
    let config = CaptureConfig::parse(&text.join("\n"), &file).unwrap();
    assert_eq!(config.cameras[0].latency_frames, Some(2));
    assert!(config.record.is_some() && config.rig.is_some() && config.service.status_socket.is_some());
}

#[test]
fn rig_toml_is_a_rig() {
    assert!(rig(&configs().join("rig.toml")).ball.is_some());
}

#[test]
fn scene_toml_fails_at_its_mesh_and_nowhere_before() {
    let error = Scene::load(&configs().join("scene.toml"), &rig(&configs().join("rig.toml"))).unwrap_err();
    assert!(
        matches!(error, mirrorball_render::error::RenderError::Read { .. }),
        "{error}"
    );
}

#[test]
fn every_config_file_is_covered_here() {
    let mut names: Vec<String> = std::fs::read_dir(configs())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(
        names,
        [
            "README.md",
            "capture.toml",
            "peers",
            "render.toml",
            "rig.toml",
            "scene.toml",
            "systemd"
        ]
    );
}

#[test]
fn carried_recordings_rigs_and_scenes_are_read() {
    for name in ["moving_lamp", "two_cameras", "fisheye"] {
        let rig = rig(&data(name).join("recording/rig.toml"));
        let scene = Scene::load(&data(name).join("scene/scene.toml"), &rig).unwrap();
        assert_eq!(scene.virtual_objects().count(), 2, "{name}");
        let player = Player::open(&data(name).join("recording"), Pace::Max, Repeat::ONCE).unwrap();
        assert!(player.n_frames() >= 2, "{name}");
    }
}
