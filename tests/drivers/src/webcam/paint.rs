//! From scene to pixels, fast enough for two webcams under emulation.
//!
//! Patches: one noisy row of each, copied from a random place for every row of the picture. Films: the logarithms of
//! the radiances plus that of the gain, through a table. Noise is in the luma alone.

use super::counter::{BLOCK_PX, COUNTER_ROWS, block_luma};
use super::jpeg::CountedJpeg;
use super::noise::{NoiseTable, Random};
use super::scene::{
    LOG_CODE_MAX, LOG_CODE_OF_ONE, LOG_STEPS_PER_STOP, Light, LinearPicture, Patches, Scene, linear_to_srgb,
};
use super::sensor::{SensorModel, SensorSettings};

/// All that a frame depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    /// What there is to see.
    pub(super) scene: &'a Scene,
    /// Which picture of a film.
    pub(super) picture_index: usize,
    /// The light on it.
    pub(super) light: Light,
    /// The sensor.
    pub(super) model: &'a SensorModel,
    /// Settings in force.
    pub(super) settings: SensorSettings,
}

impl View<'_> {
    /// Mean green signal, which the automatic exposure goes by.
    pub(super) fn mean_signal(&self) -> f32 {
        self.model
            .signal(self.scene.mean(self.picture_index), self.light, self.settings)[1]
    }
}

/// How a picture's pixels lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pixels {
    /// Two bytes a pixel, order Y U Y V; BT.601, limited range.
    Yuyv,
    /// Three bytes a pixel, full range.
    Rgb,
}

impl Pixels {
    fn bytes(self) -> usize {
        match self {
            Pixels::Yuyv => 2,
            Pixels::Rgb => 3,
        }
    }
}

/// Paints frames; keeps what it needs from one to the next.
pub(super) struct Painter {
    random: Random,
    noise: NoiseTable,
    /// Pixel code for the log code of a signal.
    code_of_log: Vec<u8>,
    /// A noisy row of one patch.
    strip: Vec<u8>,
}

/// An RGB picture as rows of blocks, 8 pixels high, some of which are shown repeatedly.
pub(super) struct BlockRows {
    rgb: Vec<u8>,
    order: Vec<usize>,
}

impl BlockRows {
    /// Encodes the picture.
    pub(super) fn encode(&self, width: usize) -> CountedJpeg {
        let rows: Vec<&[u8]> = self.rgb.chunks_exact(width * BLOCK_PX * 3).collect();
        CountedJpeg::encode(width, &rows, &self.order).expect("the encoder takes RGB pictures of our sizes")
    }
}

/// By how much a strip is longer than its patch is wide; where it begins is drawn from this many pixels.
const STRIP_PLAY_PX: usize = 256;

impl Painter {
    /// A painter whose noise follows from `seed`.
    pub(super) fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let noise = NoiseTable::new(&mut random);
        let code_of_log = (0..=LOG_CODE_MAX)
            .map(|log| {
                let signal = ((log - LOG_CODE_OF_ONE) as f32 / LOG_STEPS_PER_STOP).exp2();
                (255.0 * linear_to_srgb(signal.min(1.0))).round() as u8
            })
            .collect();
        Self {
            random,
            noise,
            code_of_log,
            strip: Vec::new(),
        }
    }

    /// Paints a picture of (width, height) into `out`, without counter. The width is even.
    pub(super) fn paint(&mut self, view: View<'_>, pixels: Pixels, (width, height): (usize, usize), out: &mut Vec<u8>) {
        out.resize(width * height * pixels.bytes(), 0);
        match view.scene {
            Scene::Patches(patches) => self.paint_patches(view, patches, pixels, (width, out)),
            Scene::Film(film) => self.paint_film(view, &film.pictures[view.picture_index], pixels, (width, out)),
        }
    }

    /// Paints an RGB picture as rows of blocks. A patch has a few different rows, which take turns.
    pub(super) fn paint_block_rows(&mut self, view: View<'_>, (width, height): (usize, usize)) -> BlockRows {
        const VARIANTS: usize = 3;
        let n_rows = height / BLOCK_PX;
        let (painted_rows, order) = match view.scene {
            Scene::Patches(patches) => {
                let patch_rows = patches.rows().max(1);
                let variant = |row: usize| row * patch_rows / n_rows * VARIANTS + row % VARIANTS;
                (patch_rows * VARIANTS, (0..n_rows).map(variant).collect())
            }
            Scene::Film(_) => (n_rows, (0..n_rows).collect()),
        };
        let mut rgb = Vec::new();
        self.paint(view, Pixels::Rgb, (width, painted_rows * BLOCK_PX), &mut rgb);
        BlockRows { rgb, order }
    }

    fn paint_patches(&mut self, view: View<'_>, patches: &Patches, pixels: Pixels, target: (usize, &mut [u8])) {
        let (width, out) = target;
        let bytes = pixels.bytes();
        let height = out.len() / (width * bytes);
        let rows = patches.rows().max(1);
        // Edges on even columns: two pixels of YUYV share their colour.
        let column_edge = |column: usize| width * column / patches.columns / 2 * 2;
        for (index, reflectance) in patches.reflectances.iter().enumerate() {
            let (row, column) = (index / patches.columns, index % patches.columns);
            let (left, right) = (column_edge(column), column_edge(column + 1));
            let length = (right - left) * bytes;
            self.fill_strip(view, *reflectance, pixels, right - left);
            for y in height * row / rows..height * (row + 1) / rows {
                let start = (self.random.draw() as usize % STRIP_PLAY_PX / 2 * 2) * bytes;
                let target = (y * width + left) * bytes;
                out[target..target + length].copy_from_slice(&self.strip[start..start + length]);
            }
        }
    }

    /// Fills the strip with a patch's colour and noise.
    fn fill_strip(&mut self, view: View<'_>, reflectance: [f32; 3], pixels: Pixels, width: usize) {
        let signal = view.model.signal(reflectance, view.light, view.settings);
        let rgb = signal.map(|channel| view.model.code(channel, view.settings));
        let deviation = fixed_point(view.model.code_noise(signal[1], view.settings));
        let place = self.random.draw() as usize;
        // Noise is added before rounding, so that the mean of a patch keeps its fraction of a code.
        let noisy = |value: i32, place: usize| {
            let noise = (self.noise.at(place) * deviation) >> 8;
            ((value + noise + 128) >> 8).clamp(0, 255) as u8
        };
        let n_pixels = width + STRIP_PLAY_PX;
        self.strip.clear();
        match pixels {
            Pixels::Yuyv => {
                let [luma, u, v] = yuv_from_rgb(rgb).map(fixed_point);
                for pair in 0..n_pixels / 2 {
                    let places = [0, 1, 2, 3].map(|part| place + 2 * pair + 1021 * part);
                    self.strip.extend([
                        noisy(luma, places[0]),
                        noisy(u, places[2]),
                        noisy(luma, places[0] + 1),
                        noisy(v, places[3]),
                    ]);
                }
            }
            Pixels::Rgb => {
                let rgb = rgb.map(fixed_point);
                for pixel in 0..n_pixels {
                    self.strip.extend(rgb.map(|channel| noisy(channel, place + pixel)));
                }
            }
        }
    }

    fn paint_film(&mut self, view: View<'_>, picture: &LinearPicture, pixels: Pixels, target: (usize, &mut [u8])) {
        let (width, out) = target;
        let bytes = pixels.bytes();
        let height = out.len() / (width * bytes);
        let (light, white) = (view.light.radiance(), view.model.white_response());
        let gains = view.model.channel_gains(view.settings);
        let shifts = [0, 1, 2].map(|channel| {
            let gain = gains[channel] * light[channel] * white[channel];
            (gain.max(1e-6).log2() * LOG_STEPS_PER_STOP).round() as i32
        });
        let brightness = view.settings.brightness / 2;
        let deviation = fixed_point(view.model.code_noise(0.18, view.settings));
        let mut place = self.random.draw() as usize;
        let columns: Vec<usize> = (0..width).map(|x| x * picture.width() / width).collect();
        for (y, out_row) in out.chunks_exact_mut(width * bytes).enumerate() {
            let row = picture.row(y, height);
            let expose = |x: usize, place: usize| {
                let noise = (self.noise.at(place) * deviation) >> 16;
                let log_codes = row[columns[x]];
                [0, 1, 2].map(|channel| {
                    let log = (i32::from(log_codes[channel]) + shifts[channel]).clamp(0, LOG_CODE_MAX);
                    let code = i32::from(self.code_of_log[log as usize]);
                    (code + brightness + noise).clamp(0, 255)
                })
            };
            match pixels {
                Pixels::Yuyv => {
                    for (pair, out_pair) in out_row.chunks_exact_mut(4).enumerate() {
                        let left = expose(2 * pair, place);
                        let right = expose(2 * pair + 1, place + 1);
                        out_pair.copy_from_slice(&yuyv_pair(left, right));
                        place += 2;
                    }
                }
                Pixels::Rgb => {
                    for (x, out_pixel) in out_row.chunks_exact_mut(3).enumerate() {
                        out_pixel.copy_from_slice(&expose(x, place).map(|code| code as u8));
                        place += 1;
                    }
                }
            }
        }
    }
}

/// Draws the frame counter over the top left of a YUYV picture.
pub(super) fn stamp_yuyv(picture: &mut [u8], width: usize, counter: u64) {
    let row: Vec<u8> = block_luma(counter)
        .flat_map(|luma| [luma, 128].into_iter().cycle().take(2 * BLOCK_PX))
        .collect();
    for picture_row in picture.chunks_exact_mut(2 * width).take(COUNTER_ROWS) {
        picture_row[..row.len()].copy_from_slice(&row);
    }
}

/// Y, U, V of pixel codes from 0 to 255: BT.601, limited range (ITU-R BT.601-7, 2.5.1 to 2.5.3).
fn yuv_from_rgb([r, g, b]: [f32; 3]) -> [f32; 3] {
    let luma = 0.299 * r + 0.587 * g + 0.114 * b;
    let chroma = |difference: f32, range: f32| 128.0 + difference / range * 112.0 / 127.5;
    [
        16.0 + luma * 219.0 / 255.0,
        chroma(b - luma, 1.772),
        chroma(r - luma, 1.402),
    ]
}

/// The same in integers for two pixels, whose mean gives the colour.
fn yuyv_pair(left: [i32; 3], right: [i32; 3]) -> [u8; 4] {
    let luma = |[r, g, b]: [i32; 3]| ((66 * r + 129 * g + 25 * b + 128) >> 8) + 16;
    let [r, g, b] = [left[0] + right[0], left[1] + right[1], left[2] + right[2]];
    let u = ((-38 * r - 74 * g + 112 * b + 256) >> 9) + 128;
    let v = ((112 * r - 94 * g - 18 * b + 256) >> 9) + 128;
    [luma(left), u, luma(right), v].map(|value| value.clamp(0, 255) as u8)
}

/// 8 bits after the point.
fn fixed_point(value: f32) -> i32 {
    (value * 256.0).round() as i32
}

#[cfg(test)]
mod tests {
    use super::super::counter;
    use super::super::scene::Film;
    use super::*;
    use std::sync::Arc;
    use std::time::Instant;

    const SETTINGS: SensorSettings = SensorSettings {
        exposure_100us: 100,
        gain: 0,
        white_balance_k: 6504,
        brightness: 0,
    };

    fn paint(scene: &Scene, pixels: Pixels) -> Vec<u8> {
        let model = SensorModel::default();
        let view = View {
            scene,
            picture_index: 0,
            light: Light::default(),
            model: &model,
            settings: SETTINGS,
        };
        let mut out = Vec::new();
        Painter::new(1).paint(view, pixels, (320, 240), &mut out);
        out
    }

    /// Mean of every fourth byte from `offset` in the picture's last third.
    fn mean_yuyv(picture: &[u8], offset: usize) -> f64 {
        let part = &picture[picture.len() * 3 / 4 / 4 * 4..];
        part.chunks_exact(4).map(|pair| f64::from(pair[offset])).sum::<f64>() / (part.len() / 4) as f64
    }

    #[test]
    fn a_grey_card_has_its_mean_to_a_tenth_of_a_code() {
        let picture = paint(&Scene::Patches(Patches::even([0.18; 3])), Pixels::Yuyv);
        let wanted = 16.0 + 117.65 * 219.0 / 255.0;
        assert!(
            (mean_yuyv(&picture, 0) - wanted).abs() < 0.15,
            "{}",
            mean_yuyv(&picture, 0)
        );
        assert!((mean_yuyv(&picture, 1) - 128.0).abs() < 0.15);
    }

    #[test]
    fn film_and_patches_agree() {
        let reflectance = [0.30, 0.18, 0.12];
        let still = LinearPicture::new(1, 1, &[reflectance]);
        let film = Film {
            pictures: Arc::new(vec![still]),
            rate_hz: 1.0,
            start: Instant::now(),
        };
        for pixels in [Pixels::Yuyv, Pixels::Rgb] {
            let patches = paint(&Scene::Patches(Patches::even(reflectance)), pixels);
            let film = paint(&Scene::Film(film.clone()), pixels);
            for offset in 0..4 {
                let (a, b) = (mean_yuyv(&patches, offset), mean_yuyv(&film, offset));
                assert!((a - b).abs() < 1.0, "{pixels:?} {offset}: {a} {b}");
            }
        }
    }

    #[test]
    fn both_conversions_agree() {
        for rgb in [[0, 0, 0], [255, 255, 255], [255, 0, 0], [10, 200, 90], [3, 7, 250]] {
            let exact = yuv_from_rgb(rgb.map(|code| code as f32));
            let pair = yuyv_pair(rgb, rgb);
            for (exact, found) in exact.iter().zip([pair[0], pair[1], pair[3]]) {
                assert!((exact - f32::from(found)).abs() < 1.2, "{rgb:?}");
            }
        }
    }

    #[test]
    fn the_counter_can_be_read_from_the_picture() {
        let mut picture = paint(&Scene::Patches(Patches::chart()), Pixels::Yuyv);
        stamp_yuyv(&mut picture, 320, 54_321);
        assert_eq!(counter::read_yuyv(&picture, 320), Some(54_321));
    }
}
