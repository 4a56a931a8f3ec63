//! Every file in `configs/` and every carried rig and scene is read by the code that it is for.

use std::path::{Path, PathBuf};

use crate::support::data;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::{Pace, Player, Repeat};
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
    assert_eq!(names, ["README.md", "render.toml", "rig.toml", "scene.toml"]);
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
