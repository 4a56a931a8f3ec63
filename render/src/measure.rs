//! The light of one frame set: every camera that sees the mirror ball, or is a fisheye, is a view of it.

use glam::{Vec3, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::cube::{self, Cube};
use mirrorball_calib::probe::fusion::ViewNoise;
use mirrorball_calib::probe::mirror_ball::MirrorBall;
use mirrorball_calib::probe::radiance::Picture;
use mirrorball_calib::probe::radiance_map::Seen;
use mirrorball_calib::probe::{ProbeOptics, View};
use mirrorball_calib::rig::{Camera, Role};
use mirrorball_capture::frame::{Frame, FrameSet};
use rayon::prelude::*;

use crate::config::Outline;
use crate::error::RenderError;
use crate::node::{MeasuredFrame, RenderNode, check_size};
use crate::passes::radiance_map::{CubePlace, gpu_probe};
use crate::probe::Sighting;
use crate::probe::surroundings::NOTHING_M;
use crate::scene::occluders::Occluders;

/// Looks at one set of pictures at most: the first tells how far away the lights are, the next sees them where they are.
const MAX_LOOKS: u32 = 3;

/// A camera that shows the light in this frame set.
struct Looking<'a> {
    /// Index of the camera in the rig.
    camera: usize,
    frame: &'a Frame,
    camera_from_world: Pose,
    optics: ProbeOptics,
}

/// Why a view of the probe tells nothing about the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BlindView {
    /// The ball is out of the picture or wholly hidden.
    #[error("the probe is not in the picture")]
    NotSeen,
    /// No outline where the ball should be.
    #[error("the ball's outline is not where the ball should be: it is hidden, or elsewhere")]
    Hidden,
    /// Everything is clipped.
    #[error("the probe's picture is clipped all over")]
    Clipped,
    /// Everything is black.
    #[error("the probe's picture is black")]
    Black,
}

impl RenderNode {
    /// Takes in every new picture of the light.
    pub(crate) fn measure_light(
        &mut self,
        set: &FrameSet,
        frame: &Frame,
        pose: Option<&Pose>,
    ) -> Result<(), RenderError> {
        if let Some(given) = &self.given_light {
            self.light = Some(self.probe.given(given));
            return Ok(());
        }
        let hidden = self.find_ball(set, frame, pose)?;
        let mut looking: Vec<Looking<'_>> = self
            .looking(set, frame, pose)?
            .into_iter()
            .filter(|view| self.is_new(view, pose.is_some()))
            .collect();
        if !looking.is_empty() {
            self.blind = None;
        }
        for view in looking.iter().filter(|view| hidden.contains(&view.camera)) {
            let camera = &self.rig.cameras[view.camera];
            let noise = noise_of(camera, view.frame, &view.optics);
            let name = camera.name.clone();
            let why = blindness(&self.look(view)?, &noise).unwrap_or(BlindView::Hidden);
            self.blind = Some((name, why));
        }
        // A first light that may be wrong is better than none, if nothing else shows any.
        if self.light.is_some() || looking.iter().any(|view| !hidden.contains(&view.camera)) {
            looking.retain(|view| !hidden.contains(&view.camera));
        }
        if looking.is_empty() {
            self.light_age += 1;
            return Ok(());
        }
        for view in &looking {
            self.measured[view.camera] = Some(measured(view.frame, pose.is_some()));
        }
        // Where the ball shows a light depends on how far away it is, which is only known after a look.
        for look in 0..MAX_LOOKS {
            if look > 0 {
                self.probe.forget();
            }
            if !self.look_once(&looking, frame, pose)? {
                self.light_age += 1;
                return Ok(());
            }
            if !self.probe.knows_better() {
                break;
            }
        }
        self.light_age = 0;
        Ok(())
    }

    /// One look at all views, and the light from them; false when none of them shows any.
    fn look_once(&mut self, looking: &[Looking<'_>], frame: &Frame, pose: Option<&Pose>) -> Result<bool, RenderError> {
        self.passes
            .radiance_map
            .write_distances(&self.gpu, self.probe.assumed_m());
        let mut views: Vec<(&Looking<'_>, Vec<Vec4>, ViewNoise)> = Vec::with_capacity(looking.len());
        for view in looking {
            let texels = self.look(view)?;
            let noise = noise_of(&self.rig.cameras[view.camera], view.frame, &view.optics);
            match blindness(&texels, &noise) {
                None => views.push((view, texels, noise)),
                Some(blind) => self.blind = Some((self.rig.cameras[view.camera].name.clone(), blind)),
            }
        }
        if views.is_empty() {
            return Ok(false);
        }
        let cameras = &self.rig.cameras;
        let sightings: Vec<Sighting<'_>> = views
            .iter()
            .map(|(view, texels, noise)| Sighting {
                texels,
                noise,
                view: view_of(&cameras[view.camera], view.frame, view.camera_from_world),
                optics: &view.optics,
            })
            .collect();
        let scene_camera = self.rig.scene_camera();
        let scene = pose.map(|pose| {
            let noise = noise_of_picture(scene_camera, frame, Vec3::ONE);
            (view_of(scene_camera, frame, *pose), noise)
        });
        let scene = scene.as_ref().map(|(view, noise)| (view, noise));
        self.light = Some(self.probe.update(&sightings, scene, &self.occluders));
        Ok(true)
    }

    /// All cameras of the set that show the light: fixed ones, and the scene camera where there is a ball.
    fn looking<'a>(
        &self,
        set: &'a FrameSet,
        scene_frame: &'a Frame,
        pose: Option<&Pose>,
    ) -> Result<Vec<Looking<'a>>, RenderError> {
        let ball = self.ball_place.as_ref().map(|place| ProbeOptics::MirrorBall {
            ball: place.ball(),
            reflectance: place.reflectance(),
        });
        let mut looking = Vec::new();
        for (index, camera) in self.rig.cameras.iter().enumerate() {
            let (frame, camera_from_world) = match camera.role {
                Role::Scene => (Some(scene_frame), pose.copied()),
                Role::Ball | Role::Fisheye => (set.camera(&camera.name), camera.camera_from_world),
            };
            let optics = match (camera.role, camera_from_world) {
                (Role::Fisheye, Some(pose)) => Some(ProbeOptics::Fisheye {
                    lens_m: pose.inverse().translation,
                }),
                _ => ball.clone(),
            };
            if let (Some(frame), Some(camera_from_world), Some(optics)) = (frame, camera_from_world, optics) {
                check_size(frame, camera)?;
                looking.push(Looking {
                    camera: index,
                    frame,
                    camera_from_world,
                    optics,
                });
            }
        }
        Ok(looking)
    }

    /// Lets the ball's outline in every new picture correct its place; gives the cameras that do not show it.
    fn find_ball(&mut self, set: &FrameSet, frame: &Frame, pose: Option<&Pose>) -> Result<Vec<usize>, RenderError> {
        let mut hidden = Vec::new();
        if self.config.probe.outline == Outline::Ignored {
            return Ok(hidden);
        }
        let is_ball = |view: &Looking<'_>| matches!(view.optics, ProbeOptics::MirrorBall { .. });
        let views: Vec<Looking<'_>> = self
            .looking(set, frame, pose)?
            .into_iter()
            .filter(|view| is_ball(view) && self.is_new(view, pose.is_some()))
            .collect();
        let Some(place) = &mut self.ball_place else {
            return Ok(hidden);
        };
        for view in views {
            let camera = &self.rig.cameras[view.camera];
            let seen = place.see(&view_of(camera, view.frame, view.camera_from_world));
            tracing::trace!(camera = camera.name, ?seen, "outline of the ball");
            if seen.is_err() {
                hidden.push(view.camera);
            }
        }
        Ok(hidden)
    }

    /// Whether a picture was not taken in yet, or only now surfaces can be read beside it.
    fn is_new(&self, view: &Looking<'_>, with_pose: bool) -> bool {
        let this = measured(view.frame, with_pose);
        let with = MeasuredFrame {
            with_pose: true,
            ..this
        };
        self.measured[view.camera].is_none_or(|last| last != this && last != with)
    }

    /// The cube that a view shows.
    fn look(&mut self, view: &Looking<'_>) -> Result<Vec<Vec4>, RenderError> {
        let camera = &self.rig.cameras[view.camera];
        let gpu_camera = self.gpu_camera(camera, &view.camera_from_world, view.frame);
        let place = CubePlace {
            origin_m: self.probe.optics().position_m(),
            room_m: self.probe.room_m(),
        };
        let camera_m = gpu_camera.position_m.truncate();
        // The distances written to the pass are whole, the room's included.
        let whole = CubePlace {
            room_m: NOTHING_M,
            ..place
        };
        let probe = gpu_probe(&view.optics, camera_m, &self.config.probe, whole);
        let picture = match &mut self.pictures.probes[view.camera] {
            Some(picture) => {
                picture.upload(&self.gpu, view.frame);
                &*picture
            }
            None => &self.seen.picture,
        };
        let mut texels = self
            .passes
            .radiance_map
            .run(&self.gpu, &mut self.timer, (&gpu_camera, &probe, picture))?;
        if let ProbeOptics::MirrorBall { ball, .. } = &view.optics {
            if ball.center_m.as_vec3().distance(place.origin_m) > ball.radius_m as f32 {
                leave_out_near(&mut texels, self.probe.near_m());
            }
            leave_out_hidden(&mut texels, ball, (camera_m, place), &self.occluders);
        }
        Ok(texels)
    }
}

fn view_of<'a>(camera: &'a Camera, frame: &'a Frame, camera_from_world: Pose) -> View<'a> {
    View {
        picture: Picture::new(frame, camera),
        camera,
        camera_from_world,
    }
}

fn measured(frame: &Frame, with_pose: bool) -> MeasuredFrame {
    MeasuredFrame {
        sequence: frame.meta.sequence,
        timestamp_ns: frame.meta.timestamp_ns,
        with_pose,
    }
}

fn noise_of(camera: &Camera, frame: &Frame, optics: &ProbeOptics) -> ViewNoise {
    let reflectance = match optics {
        ProbeOptics::MirrorBall { reflectance, .. } => *reflectance,
        ProbeOptics::Fisheye { .. } => Vec3::ONE,
    };
    noise_of_picture(camera, frame, reflectance)
}

fn noise_of_picture(camera: &Camera, frame: &Frame, reflectance: Vec3) -> ViewNoise {
    ViewNoise::new(&camera.photometry, &frame.meta.exposure, reflectance)
}

/// Why a view tells nothing; `None` for one that does.
fn blindness(texels: &[Vec4], noise: &ViewNoise) -> Option<BlindView> {
    /// A view that shows less than this share of the directions is none.
    const LEAST_SEEN: f32 = 0.005;
    /// A picture of which more than this share is clipped or black tells nothing.
    const MOST_LOST: f32 = 0.95;
    let mut seen = 0usize;
    // Weighted by quality: near the ball's outline the background is mixed in.
    let (mut total, mut clipped, mut black) = (0.0f32, 0.0f32, 0.0f32);
    for texel in texels.iter().filter_map(|texel| Seen::unpack(*texel)) {
        seen += 1;
        total += texel.quality;
        if texel.clipped == 7 {
            clipped += texel.quality;
        } else if noise.is_black(texel.radiance) {
            black += texel.quality;
        }
    }
    if (seen as f32) < LEAST_SEEN * texels.len() as f32 {
        return Some(BlindView::NotSeen);
    }
    let lost = MOST_LOST * total;
    if clipped > lost {
        Some(BlindView::Clipped)
    } else if black > lost {
        Some(BlindView::Black)
    } else {
        None
    }
}

/// Takes out phantoms near the cube's centre: a ball that stands elsewhere sees their other sides.
fn leave_out_near(texels: &mut [Vec4], near_m: &Cube<f32>) {
    for (texel, &near) in texels.iter_mut().zip(near_m.texels()) {
        if near < NOTHING_M {
            *texel = Vec4::ZERO;
        }
    }
}

/// Takes out what a camera cannot see of the ball because a phantom stands before it.
///
/// Asked for a coarse cube of directions: what hides the ball is large beside a texel.
fn leave_out_hidden(
    texels: &mut [Vec4],
    ball: &MirrorBall,
    (camera_m, place): (Vec3, CubePlace),
    occluders: &Occluders,
) {
    const COARSE: u32 = 16;
    let is_hidden = |index: usize| {
        let towards = place.origin_m + cube::texel_direction(COARSE, index) * place.room_m;
        let from_ball = towards.as_dvec3() - ball.center_m;
        let Some(glint) = ball.glint(camera_m.as_dvec3(), from_ball.normalize(), from_ball.length()) else {
            return false;
        };
        let way = glint.point_m.as_vec3() - camera_m;
        let ray = way.normalize();
        // The ball's own phantom does not hide it.
        occluders.distance_m(camera_m, ray, 1e-3).is_some_and(|hit_m| {
            let hit = camera_m + ray * hit_m;
            hit_m < way.length() && hit.distance(ball.center_m.as_vec3()) > 1.1 * ball.radius_m as f32
        })
    };
    let hidden: Vec<bool> = (0..6 * (COARSE * COARSE) as usize)
        .into_par_iter()
        .map(is_hidden)
        .collect();
    if !hidden.contains(&true) {
        return;
    }
    let Some(hidden) = Cube::from_texels(COARSE, hidden) else {
        return;
    };
    let size = ((texels.len() / 6) as f32).sqrt().round() as u32;
    texels.par_iter_mut().enumerate().for_each(|(index, texel)| {
        if hidden.nearest(cube::texel_direction(size, index)) {
            *texel = Vec4::ZERO;
        }
    });
}
