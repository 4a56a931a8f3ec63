//! Small vectors at places in a picture.

use std::collections::HashMap;

use maud::{Markup, html};

use super::{
    Scale,
    frame::{Frame, MarkedAxis, WIDTH},
    is_drawable,
    svg::{Path, drawing, number},
    ticks::{Span, nice_step, short},
};

/// Largest height of the picture on the page.
pub(super) const MAX_HEIGHT: f64 = 620.0;

/// Vectors drawn at most.
const MAX_VECTORS: usize = 2500;

/// Least and greatest length of the arrow that shows the scale, on the page.
const ARROW: (f64, f64) = (14.0, 110.0);

type Vector = ([f64; 2], [f64; 2]);

/// The picture's rectangle with the vectors, and an arrow that says how long they are.
pub(super) fn draw(name: &str, size_px: [u32; 2], vectors: &[Vector], scale: f64) -> Markup {
    let scale = if scale > 0.0 && is_drawable(scale) { scale } else { 1.0 };
    let picture = Picture::new(size_px);
    let drawable: Vec<Vector> = vectors
        .iter()
        .filter(|(at, vector)| at.iter().chain(vector).all(|value| is_drawable(*value)))
        .copied()
        .collect();
    let shown = thin(&drawable, size_px);
    let (mut lines, mut places) = (Path::default(), Path::default());
    for (at, vector) in &shown {
        let tip = [0, 1].map(|axis| at[axis] + scale * vector[axis]);
        let (at, tip) = (picture.inner(*at), picture.inner(tip));
        places.dot(at);
        lines.move_to(at);
        lines.line_to(tip);
    }
    let content = html! {
        (picture.axes())
        // An element of its own cuts off what points out of the picture.
        svg x=(number(picture.frame.left)) y=(number(picture.frame.top)) width=(number(picture.frame.width))
            height=(number(picture.frame.height)) overflow="hidden" {
            @if !shown.is_empty() {
                path class="series s1" d=(lines.into_data()) fill="none" stroke="currentColor" stroke-width="1.3" {}
                path class="series s0" d=(places.into_data()) fill="none" stroke="currentColor" stroke-width="3.2"
                    stroke-linecap="round" {}
            }
        }
        (picture.scale_arrow(scale))
    };
    let size = picture.frame.outer();
    html! {
        (drawing(name, [size[0], size[1] + 30.0], &content))
        @if shown.len() < drawable.len() {
            p class="note" { "Of " (drawable.len()) " vectors, the longest of every neighbourhood: " (shown.len()) "." }
        }
    }
}

/// The longest vector of every cell of a grid over the picture, when there are too many.
fn thin(vectors: &[Vector], [width, height]: [u32; 2]) -> Vec<Vector> {
    if vectors.len() <= MAX_VECTORS {
        return vectors.to_vec();
    }
    let side = (f64::from(width.max(1)) * f64::from(height.max(1)) / MAX_VECTORS as f64).sqrt();
    let length = |vector: &Vector| vector.1[0].hypot(vector.1[1]);
    let mut longest: HashMap<[i64; 2], usize> = HashMap::new();
    for (index, vector) in vectors.iter().enumerate() {
        // Places far outside share the cells at the border.
        let cell = [(0, width), (1, height)].map(|(axis, size)| {
            let inside = vector.0[axis].clamp(0.0, f64::from(size));
            (inside / side).floor() as i64
        });
        let best = longest.entry(cell).or_insert(index);
        if length(vector) > length(&vectors[*best]) {
            *best = index;
        }
    }
    let mut kept: Vec<usize> = longest.into_values().collect();
    kept.sort_unstable();
    kept.into_iter().map(|index| vectors[index]).collect()
}

/// A picture's rectangle on the page, true to scale, with pixels along its sides.
pub(super) struct Picture {
    pub(super) frame: Frame,
    size: [f64; 2],
}

impl Picture {
    pub(super) fn new(size_px: [u32; 2]) -> Self {
        let size = size_px.map(|side| f64::from(side.max(1)));
        let left = 34.0 + 40.0;
        let available = WIDTH - left - 110.0;
        let scale = (available / size[0]).min(MAX_HEIGHT / size[1]);
        let frame = Frame {
            left,
            top: 16.0,
            // Very long pictures stay visible.
            width: (size[0] * scale).max(20.0),
            height: (size[1] * scale).max(20.0),
        };
        Self { frame, size }
    }

    /// Pixels on the page per pixel of the picture, across and down.
    fn scale(&self) -> [f64; 2] {
        [self.frame.width / self.size[0], self.frame.height / self.size[1]]
    }

    /// Where a place of the picture lies in its rectangle. Integer coordinates are pixel centres.
    fn inner(&self, at: [f64; 2]) -> [f64; 2] {
        let scale = self.scale();
        // Far outside is as good as further outside, and short to write.
        [0, 1].map(|axis| ((at[axis] + 0.5) * scale[axis]).clamp(-1e4, 1e4))
    }

    /// Border, marks, names.
    pub(super) fn axes(&self) -> Markup {
        let axis = |name: &'static str, side: usize, length: f64| {
            let ends = [-0.5, self.size[side] - 0.5];
            let span = Span::of(Scale::Linear, ends.into_iter());
            MarkedAxis::new(name, if side == 1 { span.flipped() } else { span }, length, side)
        };
        let x = axis("x, px", 0, self.frame.width);
        let y = axis("y, px", 1, self.frame.height);
        self.frame.draw(&x, &y)
    }

    fn scale_arrow(&self, scale: f64) -> Markup {
        let per_px = scale * self.scale()[0];
        let value = if (ARROW.0..=ARROW.1).contains(&per_px) {
            1.0
        } else {
            nice_step(40.0 / per_px)
        };
        let length = (value * per_px).clamp(1.0, 2.0 * ARROW.1);
        let y = self.frame.outer()[1] + 12.0;
        let (x, end) = (self.frame.left, self.frame.left + length);
        let mut arrow = Path::default();
        arrow.move_to([x, y]);
        arrow.line_to([end, y]);
        arrow.move_to([end - 5.0, y - 4.0]);
        arrow.line_to([end, y]);
        arrow.line_to([end - 5.0, y + 4.0]);
        html! {
            path class="series s1" d=(arrow.into_data()) fill="none" stroke="currentColor" stroke-width="1.6" {}
            text x=(number(end + 8.0)) y=(number(y + 4.0)) { (short(value)) " px" }
        }
    }
}
