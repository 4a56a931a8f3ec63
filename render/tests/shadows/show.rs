//! The scene without camera as it is shown.

use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::MAP_SIZE;
use mirrorball_render::lab::lamp::{Lamp, LampKind};
use mirrorball_render::lab::scenes::{self, MovingScene};
use mirrorball_render::lab::show::{Action, Choice, Show};
use mirrorball_render::shadow::ShadowMethod;

#[test]
fn keys_change_the_picture_and_a_pause_holds_it() {
    let choice = Choice {
        method: ShadowMethod::None,
        map_size: MAP_SIZE,
        lamp: Lamp::over_test_scene(LampKind::Rect),
    };
    let view = scenes::view([96, 72]);
    let mut show = Show::new(Gpu::open().unwrap(), MovingScene::test(0), &view, choice).unwrap();
    let first = show.picture().unwrap().rgba;
    assert_eq!(first.len(), 4 * 96 * 72);
    show.advance(0.5);
    let moved = show.picture().unwrap().rgba;
    assert_ne!(first, moved);
    show.act(Action::Pause);
    show.advance(0.5);
    assert_eq!(moved, show.picture().unwrap().rgba);
    show.act(Action::MoveLamp(10.0 * glam::Vec3::X));
    let under_moved_lamp = show.picture().unwrap().rgba;
    assert_ne!(moved, under_moved_lamp);
    show.act(Action::NextLamp);
    assert_ne!(under_moved_lamp, show.picture().unwrap().rgba);
    show.act(Action::NextMethod);
    assert_eq!(show.state().0, ShadowMethod::Blob);
}
