//! The rectangle that data are drawn in, with its axes.

use maud::{Markup, html};

use super::{
    super::text::printable,
    svg::{number, text_width},
    ticks::{Span, Ticks},
};

/// Width of a plot in pixels; a page's column is about as wide.
pub(super) const WIDTH: f64 = 720.0;

/// Room above the rectangle and to its right, so that labels at its ends are not cut.
const MARGIN: f64 = 16.0;

/// Room below it for labels and the name of the axis.
const BELOW: f64 = 46.0;

/// Pixels between two labels beside each other, and above each other.
const LABEL_PITCH: [f64; 2] = [62.0, 45.0];

/// Where data are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) width: f64,
    pub(super) height: f64,
}

/// An axis with what belongs to it.
#[derive(Debug, Clone)]
pub(super) struct MarkedAxis<'a> {
    pub(super) name: &'a str,
    pub(super) span: Span,
    ticks: Ticks,
}

impl<'a> MarkedAxis<'a> {
    /// With as many marks as there is room for along so many pixels; `direction` is 0 for a horizontal axis, 1 for a
    /// vertical one.
    pub(super) fn new(name: &'a str, span: Span, length: f64, direction: usize) -> Self {
        let wanted = (length / LABEL_PITCH[direction]).max(2.0) as usize;
        Self {
            name,
            span,
            ticks: span.ticks(wanted),
        }
    }

    /// Room that the labels take beside a vertical axis.
    pub(super) fn label_width(&self) -> f64 {
        let widths = self.ticks.ticks.iter().map(|tick| text_width(&tick.label));
        widths.fold(20.0, f64::max)
    }

    /// Name with the factor of the labels.
    pub(super) fn title(&self) -> String {
        match self.ticks.factor.as_str() {
            "" => printable(self.name).into_owned(),
            factor => format!("{} ({factor})", printable(self.name)),
        }
    }

    /// Places along the axis, 0 to 1, and labels.
    pub(super) fn marks(&self) -> impl Iterator<Item = (f64, &str)> {
        self.ticks
            .ticks
            .iter()
            .filter_map(|tick| Some((self.span.place(tick.value)?.clamp(0.0, 1.0), tick.label.as_str())))
    }
}

impl Frame {
    /// Right of the labels of `y`, as high as given.
    pub(super) fn beside(y: &MarkedAxis<'_>, height: f64) -> Self {
        let left = 34.0 + y.label_width().min(0.3 * WIDTH);
        Self {
            left,
            top: MARGIN,
            width: WIDTH - left - MARGIN,
            height,
        }
    }

    /// Size of the whole drawing.
    pub(super) fn outer(&self) -> [f64; 2] {
        [WIDTH, self.top + self.height + BELOW]
    }

    /// Pixel of a place given as 0 to 1 from the left and from the bottom.
    pub(super) fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [self.left + x * self.width, self.top + (1.0 - y) * self.height]
    }

    /// Grid, border, marks, labels and names of both axes.
    pub(super) fn draw(&self, x: &MarkedAxis<'_>, y: &MarkedAxis<'_>) -> Markup {
        let bottom = self.top + self.height;
        let right = self.left + self.width;
        html! {
            g class="grid" stroke="currentColor" {
                @for (place, label) in x.marks() {
                    @let at = number(self.at(place, 0.0)[0]);
                    line x1=(at) x2=(at) y1=(number(self.top)) y2=(number(bottom)) stroke-opacity=(opacity(label)) {}
                }
                @for (place, label) in y.marks() {
                    @let at = number(self.at(0.0, place)[1]);
                    line x1=(number(self.left)) x2=(number(right)) y1=(at) y2=(at) stroke-opacity=(opacity(label)) {}
                }
            }
            (self.border())
            g text-anchor="middle" {
                @for (place, label) in x.marks() {
                    text x=(number(self.at(place, 0.0)[0])) y=(number(bottom + 17.0)) { (label) }
                }
                text class="axis" x=(number(self.left + 0.5 * self.width)) y=(number(bottom + 38.0)) { (x.title()) }
            }
            g text-anchor="end" {
                @for (place, label) in y.marks() {
                    text x=(number(self.left - 7.0)) y=(number(self.at(0.0, place)[1] + 4.0)) { (label) }
                }
            }
            text class="axis" text-anchor="middle"
                transform=(format!("translate(14 {}) rotate(-90)", number(self.top + 0.5 * self.height))) { (y.title()) }
        }
    }

    /// The rectangle itself.
    pub(super) fn border(&self) -> Markup {
        html! {
            rect x=(number(self.left)) y=(number(self.top)) width=(number(self.width)) height=(number(self.height))
                fill="none" stroke="currentColor" stroke-opacity="0.5" {}
        }
    }
}

/// Lines without a label are fainter.
fn opacity(label: &str) -> &'static str {
    if label.is_empty() { "0.07" } else { "0.17" }
}
