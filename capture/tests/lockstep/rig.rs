//! Simulated cameras driven by a [`Lockstep`], frame by frame in the order of time.

use mirrorball_capture::lockstep::{FrameExposure, Lockstep, Request};
use mirrorball_capture::{ControlValues, Meter, PixelFormat, Response, Size};

use crate::room::{HEIGHT, Light, Model, Random, Room, WIDTH};

/// How badly the drivers behave: shares of frames and requests, 0 to 1.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Faults {
    /// Frames that the driver loses, with a gap in the sequence.
    pub(crate) lost: f64,
    /// Frames that the sensor loses, without a gap.
    pub(crate) lost_in_sensor: f64,
    /// Requests that are refused.
    pub(crate) refused: f64,
    /// Requests that take one frame more to be accepted and answered.
    pub(crate) late: f64,
}

/// A frame, and what only the simulation knows about it.
#[derive(Debug, Clone)]
pub(crate) struct Taken {
    pub(crate) camera: usize,
    pub(crate) timestamp_ns: u64,
    pub(crate) pixels: Vec<u8>,
    pub(crate) said: FrameExposure,
    pub(crate) truth: ControlValues,
}

struct Simulated {
    model: Model,
    meter: Meter,
    n_taken: i64,
    sequence: u64,
    /// Changes of the controls and the sensor's frame that shows them first.
    changes: Vec<(i64, ControlValues)>,
    accepted: ControlValues,
    late: Option<Request>,
}

impl Simulated {
    fn taken_ns(&self) -> u64 {
        (1e9 + self.model.phase_ns + self.n_taken as f64 * self.model.interval_ns) as u64
    }

    fn in_force(&self) -> ControlValues {
        let shown = self.changes.iter().rev().find(|change| change.0 <= self.n_taken);
        shown.map_or(self.model.start(), |change| change.1)
    }

    /// The driver takes a request before the sensor's frame `before`.
    fn accept(&mut self, request: &Request, before: i64) {
        for (kind, value) in request.values.iter() {
            self.accepted.set(kind, value);
        }
        self.changes
            .push((before + i64::from(self.model.latency_frames), self.accepted));
    }
}

pub(crate) struct Rig {
    pub(crate) lockstep: Lockstep,
    pub(crate) room: Room,
    pub(crate) faults: Faults,
    pub(crate) random: Random,
    cameras: Vec<Simulated>,
}

impl Rig {
    pub(crate) fn new(lockstep: Lockstep, models: &[Model], seed: u64) -> Self {
        let simulated = |model: &Model| Simulated {
            model: *model,
            meter: Meter::new(Response::srgb()),
            n_taken: 0,
            sequence: 0,
            changes: Vec::new(),
            accepted: model.start(),
            late: None,
        };
        Self {
            lockstep,
            room: Room::new(seed),
            faults: Faults::default(),
            random: Random(seed ^ 0x5eed),
            cameras: models.iter().map(simulated).collect(),
        }
    }

    /// Takes the next frame of whichever camera is next; none if it was lost. `light` gives the room's light by time
    /// in seconds.
    pub(crate) fn step(&mut self, light: impl Fn(f64) -> Light) -> Option<Taken> {
        let next = |index: &usize| self.cameras[*index].taken_ns();
        let index = (0..self.cameras.len()).min_by_key(next).expect("there is a camera");
        let timestamp_ns = self.cameras[index].taken_ns();
        let chance = self.random.even();
        let lost_in_sensor = chance < self.faults.lost_in_sensor;
        let lost = !lost_in_sensor && chance < self.faults.lost_in_sensor + self.faults.lost;
        let taken = if lost || lost_in_sensor {
            None
        } else {
            Some(self.take(index, timestamp_ns, &light))
        };
        let camera = &mut self.cameras[index];
        camera.n_taken += 1;
        camera.sequence += u64::from(!lost_in_sensor);
        taken
    }

    fn take(&mut self, index: usize, timestamp_ns: u64, light: &impl Fn(f64) -> Light) -> Taken {
        let camera = &mut self.cameras[index];
        if let Some(request) = camera.late.take() {
            camera.accept(&request, camera.n_taken);
            self.lockstep
                .on_applied(index, request.id, &camera.accepted, camera.sequence);
        }
        let truth = camera.in_force();
        let light = light(timestamp_ns as f64 * 1e-9);
        let pixels = camera.model.picture(&self.room, light, &truth, &mut self.random);
        let size = Size {
            width: WIDTH as u32,
            height: HEIGHT as u32,
        };
        let said = self
            .lockstep
            .on_frame(index, camera.sequence, timestamp_ns)
            .expect("the camera is there");
        let statistics = camera
            .meter
            .measure(size, PixelFormat::Rgb8, &pixels)
            .expect("a picture");
        self.lockstep.on_statistics(index, camera.sequence, &statistics);
        if let Some(request) = self.lockstep.request(index) {
            let chance = self.random.even();
            if chance < self.faults.refused {
                self.lockstep.on_refused(index, request.id);
            } else if chance < self.faults.refused + self.faults.late && camera.late.is_none() {
                camera.late = Some(request);
            } else {
                camera.accept(&request, camera.n_taken + 1);
                self.lockstep
                    .on_applied(index, request.id, &camera.accepted, camera.sequence + 1);
            }
        }
        Taken {
            camera: index,
            timestamp_ns,
            pixels,
            said,
            truth,
        }
    }

    /// Takes frames until a moment, in seconds; the simulation starts at 1 s.
    pub(crate) fn run(&mut self, until_s: f64, light: impl Fn(f64) -> Light) -> Vec<Taken> {
        let mut taken = Vec::new();
        while self
            .cameras
            .iter()
            .all(|camera| camera.taken_ns() as f64 * 1e-9 < until_s)
        {
            taken.extend(self.step(&light));
        }
        taken
    }
}
