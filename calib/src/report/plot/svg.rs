//! What all drawings share: the element around them, and numbers in it.

use std::fmt::Write;

use maud::{Markup, html};

use super::super::text::printable;

/// A drawing of this size in its own units, which are a screen's pixels where there is room. `name` is what a screen reader
/// says.
pub(super) fn drawing(name: &str, [width, height]: [f64; 2], content: &Markup) -> Markup {
    let view = format!("0 0 {} {}", number(width), number(height));
    html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(view) width=(number(width)) height=(number(height)) role="img"
            aria-label=(printable(name)) font-size="12" font-family="system-ui, sans-serif" fill="currentColor" {
            (content)
        }
    }
}

/// A length or place, to a hundredth of a pixel.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Width of a text in pixels, roughly; fonts differ.
pub(super) fn text_width(text: &str) -> f64 {
    6.8 * text.chars().count() as f64
}

/// The data of a `path`.
#[derive(Debug, Default)]
pub(super) struct Path {
    data: String,
}

impl Path {
    /// Begins at a place.
    pub(super) fn move_to(&mut self, [x, y]: [f64; 2]) {
        self.command('M', x, y);
    }

    /// A line to a place.
    pub(super) fn line_to(&mut self, [x, y]: [f64; 2]) {
        self.command('L', x, y);
    }

    /// A dot: a line without length, which round or square ends make visible.
    pub(super) fn dot(&mut self, at: [f64; 2]) {
        self.move_to(at);
        self.data.push_str("h0");
    }

    pub(super) fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    pub(super) fn into_data(self) -> String {
        self.data
    }

    fn command(&mut self, command: char, x: f64, y: f64) {
        write!(self.data, "{command}{} {}", number(x), number(y)).expect("a string takes everything");
    }
}
