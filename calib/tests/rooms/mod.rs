//! Rooms to find lights in, and a camera with 8 bits and noise that sees them.

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::response::ResponseCurve;

/// Edge of the maps' faces.
pub(crate) const SIZE: u32 = 128;

/// Something bright: a disc, or a rectangle of directions.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lamp {
    direction: Vec3,
    /// Half width and half height, degrees.
    half_deg: [f32; 2],
    is_round: bool,
    radiance: f32,
    tint: Vec3,
}

impl Lamp {
    pub(crate) fn round(direction: Vec3, radius_deg: f32, radiance: f32) -> Self {
        Self {
            direction: direction.normalize(),
            half_deg: [radius_deg; 2],
            is_round: true,
            radiance,
            tint: Vec3::ONE,
        }
    }

    pub(crate) fn rectangle(direction: Vec3, half_deg: [f32; 2], radiance: f32) -> Self {
        Self {
            half_deg,
            is_round: false,
            ..Self::round(direction, 0.0, radiance)
        }
    }

    pub(crate) fn tinted(self, tint: Vec3) -> Self {
        Self { tint, ..self }
    }

    /// How much of a texel it fills: its edge is as soft as a texel is wide.
    fn coverage(&self, direction: Vec3) -> f32 {
        let texel_deg = (2.0 / SIZE as f32).to_degrees();
        let soft = |inside_deg: f32| (inside_deg / texel_deg + 0.5).clamp(0.0, 1.0);
        if self.is_round {
            return soft(self.half_deg[0] - direction.angle_between(self.direction).to_degrees());
        }
        let across = self.direction.any_orthonormal_vector();
        let up = self.direction.cross(across);
        let depth = direction.dot(self.direction);
        if depth <= 0.0 {
            return 0.0;
        }
        let at_deg = |axis: Vec3| (direction.dot(axis) / depth).atan().abs().to_degrees();
        soft(self.half_deg[0] - at_deg(across)) * soft(self.half_deg[1] - at_deg(up))
    }
}

/// Walls of uneven brightness, and lamps.
#[derive(Debug, Clone)]
pub(crate) struct Room {
    pub(crate) name: &'static str,
    wall: f32,
    lamps: Vec<Lamp>,
    /// Radiance that a pixel which is clipped is taken to have.
    pub(crate) put_back: f32,
}

impl Room {
    pub(crate) fn dim() -> Self {
        Self {
            name: "dim",
            wall: 0.3,
            lamps: Vec::new(),
            put_back: 200.0,
        }
    }

    /// A window whose outline is as bright as the camera can count: every pixel of it is clipped in half of the frames.
    pub(crate) fn window() -> Self {
        Self {
            name: "window",
            put_back: 14.0,
            ..Self::dim()
        }
        .with(Lamp::rectangle(Vec3::new(-1.0, 0.3, 0.4), [14.8, 11.8], 4.0))
        .with(Lamp::rectangle(Vec3::new(-1.0, 0.3, 0.4), [13.0, 10.0], 9.0))
    }

    pub(crate) fn with(mut self, lamp: Lamp) -> Self {
        self.lamps.push(lamp);
        self
    }

    /// Rooms as there are: a lamp, a window, two lamps and a panel, an overcast sky through the ceiling.
    pub(crate) fn all() -> [Self; 4] {
        [
            Self {
                name: "lamp",
                ..Self::dim().with(Lamp::round(Vec3::new(0.2, 0.6, 0.8), 2.5, 300.0))
            },
            Self::window(),
            Self {
                name: "panel",
                put_back: 60.0,
                ..Self::dim()
                    .with(Lamp::rectangle(Vec3::new(0.1, 0.2, 1.0), [14.0, 6.0], 12.0))
                    .with(Lamp::round(Vec3::new(0.9, 0.6, 0.5), 3.0, 60.0))
                    .with(Lamp::round(Vec3::new(0.9, -0.6, 0.3), 1.5, 60.0))
            },
            Self {
                name: "overcast",
                put_back: 3.0,
                ..Self::dim().with(Lamp::rectangle(Vec3::Z, [44.0, 40.0], 2.9))
            },
        ]
    }

    pub(crate) fn map(&self) -> Cube<Vec3> {
        let mut map = Cube::filled(SIZE, Vec3::ZERO);
        for index in 0..map.texels().len() {
            let d = map.direction(index);
            // Posters and shelves: patches of other brightness.
            let patches = (7.0 * d.x).sin() * (5.0 * d.y + 1.0).sin() * (6.0 * d.z).cos();
            let mut radiance = Vec3::new(1.0, 0.9, 0.8) * self.wall * (1.0 + 0.3 * d.z + 0.4 * patches);
            for lamp in &self.lamps {
                radiance = radiance.lerp(lamp.tint * lamp.radiance, lamp.coverage(d));
            }
            map.texels_mut()[index] = radiance;
        }
        map
    }
}

/// A camera of 8 bits.
#[derive(Debug)]
pub(crate) struct Camera {
    pub(crate) response: ResponseCurve,
    /// Radiance of the brightest code.
    pub(crate) clips_at: f32,
    pub(crate) full_well_e: f32,
    pub(crate) read_noise_e: f32,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            response: ResponseCurve::srgb(),
            clips_at: 4.0,
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
        }
    }
}

impl Camera {
    /// The map as the camera sees it in a frame: with noise, in 8 bits, clipped; what is clipped is taken for `put_back`.
    pub(crate) fn sees(&self, truth: &Cube<Vec3>, put_back: f32, frame: u64) -> Cube<Vec3> {
        let mut noise = Noise(frame.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d);
        truth.map(|radiance| {
            let code = |signal: f32| {
                let read = self.read_noise_e / self.full_well_e;
                let sigma = (signal / self.full_well_e + read * read).sqrt();
                self.response.encode(f64::from(signal + sigma * noise.normal()))
            };
            let mut code = code;
            let codes = radiance.to_array().map(|value| code(value / self.clips_at));
            let factor = put_back / self.clips_at;
            Vec3::from_array(codes.map(|code| {
                let value = self.response.linear_from_code(code) as f32 * self.clips_at;
                if code == 255 { value * factor } else { value }
            }))
        })
    }
}

/// Normally distributed numbers, the same for the same seed (SplitMix64, Steele et al. 2014; Box and Muller 1958).
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    fn normal(&mut self) -> f32 {
        let (a, b) = (self.uniform().max(1e-7), self.uniform());
        (-2.0 * a.ln()).sqrt() * (2.0 * std::f32::consts::PI * b).cos()
    }
}
