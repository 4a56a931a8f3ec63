//! What a webcam knows about every frame of its sensor, for tests to hold against what a program claims.

use std::collections::VecDeque;

use super::faults::FrameFault;
use super::scene::Light;
use super::sensor::SensorSettings;

/// Frames that are remembered: a quarter of an hour at 60 frames a second. As many as the counter in the picture
/// tells apart.
const MEMORY_FRAMES: usize = 65_536;

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It went out whole.
    Sent,
    /// It was struck by a fault.
    Faulty(FrameFault),
    /// The host was not done with the frame before when this one was due.
    Overrun,
}

/// The truth about one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTruth {
    /// Number since the webcam was made; its low 16 bits are in the picture.
    pub counter: u64,
    /// Monotonic time at which its first packet went out, in ns.
    pub start_ns: u64,
    /// Settings that were in force.
    pub settings: SensorSettings,
    /// Settings asked for when it began.
    pub requested: SensorSettings,
    /// True exposure: time × gain, of 10 ms at gain 1, with the nonlinearity of the sensor.
    pub exposure: f32,
    /// Signal of a white surface (reflectance 1) in the sensor's red, green and blue; 1 saturates.
    pub white_signal: [f32; 3],
    /// Light on the scene.
    pub light: Light,
    /// Picture of the film.
    pub picture_index: usize,
    /// What became of it.
    pub fate: Fate,
}

/// The last frames of a webcam.
#[derive(Clone, Debug, Default)]
pub struct TruthLog(VecDeque<FrameTruth>);

impl TruthLog {
    /// Adds a frame; its counter is one more than the last one's.
    pub fn push(&mut self, frame: FrameTruth) {
        if self.0.len() == MEMORY_FRAMES {
            self.0.pop_front();
        }
        self.0.push_back(frame);
    }

    /// The youngest frame whose counter ends in these 16 bits.
    pub fn find(&self, shown: u16) -> Option<FrameTruth> {
        let last = self.0.back()?.counter;
        let age = last.wrapping_sub(u64::from(shown)) & 0xFFFF;
        let index = (self.0.len() as u64).checked_sub(age + 1)?;
        self.0.get(index as usize).copied()
    }

    /// All frames, oldest first.
    pub fn frames(&self) -> Vec<FrameTruth> {
        self.0.iter().copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(counter: u64) -> FrameTruth {
        let settings = SensorSettings {
            exposure_100us: 1,
            gain: 0,
            white_balance_k: 5000,
            brightness: 0,
        };
        FrameTruth {
            counter,
            start_ns: 0,
            settings,
            requested: settings,
            exposure: 1.0,
            white_signal: [1.0; 3],
            light: Light::default(),
            picture_index: 0,
            fate: Fate::Sent,
        }
    }

    #[test]
    fn frames_are_found_by_the_bits_in_the_picture() {
        let mut log = TruthLog::default();
        assert_eq!(log.find(0), None);
        for counter in 0..70_000 {
            log.push(frame(counter));
        }
        assert_eq!(log.frames().len(), MEMORY_FRAMES);
        assert_eq!(
            log.find((69_999_u32 & 0xFFFF) as u16).map(|frame| frame.counter),
            Some(69_999)
        );
        assert_eq!(log.find(60_000).map(|frame| frame.counter), Some(60_000));
        assert_eq!(log.find(100).map(|frame| frame.counter), Some(65_636));
    }
}
