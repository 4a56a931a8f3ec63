//! Points and lines over two axes.

use maud::{Markup, html};

use super::{
    super::text::printable,
    Axis, Series, Style,
    frame::{Frame, MarkedAxis},
    svg::{Path, drawing},
    thin,
    ticks::Span,
};

/// Height of the rectangle in pixels.
const HEIGHT: f64 = 320.0;

/// Colours of series; the page's style sheet says which (Okabe and Ito 2008, "Color universal design").
const COLOURS: usize = 6;

/// The chart and the legend of its series.
pub(super) fn draw(name: &str, x: &Axis, y: &Axis, series: &[Series]) -> Markup {
    let values = |axis: usize| {
        // A point is shown when both of its values can be.
        let spans = [x.scale, y.scale].map(|scale| Span::of(scale, std::iter::empty()));
        let shown = series.iter().flat_map(|series| &series.points);
        shown
            .filter(move |point| spans[0].place(point[0]).is_some() && spans[1].place(point[1]).is_some())
            .map(move |point| point[axis])
    };
    let y = MarkedAxis::new(&y.name, Span::around(y.scale, values(1)), HEIGHT, 1);
    let frame = Frame::beside(&y, HEIGHT);
    let x = MarkedAxis::new(&x.name, Span::around(x.scale, values(0)), frame.width, 0);
    let content = html! {
        (frame.draw(&x, &y))
        @for (index, series) in series.iter().enumerate() {
            g class=(class(index, series)) { (line(&frame, &x.span, &y.span, series, index)) }
        }
    };
    html! {
        (drawing(name, frame.outer(), &content))
        (legend(series))
    }
}

fn line(frame: &Frame, x: &Span, y: &Span, series: &Series, index: usize) -> Markup {
    let place = |point: &[f64; 2]| Some(frame.at(x.place(point[0])?, y.place(point[1])?));
    let mut path = Path::default();
    match series.style {
        Style::Dots => {
            let points: Vec<_> = series.points.iter().filter_map(place).collect();
            thin::dots(&points).into_iter().for_each(|at| path.dot(at));
        }
        Style::Line | Style::Dashed => {
            // What is left out is a gap.
            let places: Vec<_> = series.points.iter().map(place).collect();
            for piece in places.split(Option::is_none) {
                let points: Vec<_> = piece.iter().copied().flatten().collect();
                let points = thin::line(&points);
                let Some((first, rest)) = points.split_first() else {
                    continue;
                };
                if rest.is_empty() {
                    path.dot(*first);
                    continue;
                }
                path.move_to(*first);
                rest.iter().for_each(|at| path.line_to(*at));
            }
        }
    }
    stroke(path, series.style, index)
}

fn stroke(path: Path, style: Style, index: usize) -> Markup {
    let (width, cap, dashes) = match style {
        // Neighbours differ in shape too.
        Style::Dots if index.is_multiple_of(2) => ("4.5", "round", None),
        Style::Dots => ("3.5", "square", None),
        Style::Line => ("1.8", "round", None),
        Style::Dashed => ("1.5", "butt", Some("6 4")),
    };
    html! {
        @if !path.is_empty() {
            path d=(path.into_data()) fill="none" stroke="currentColor" stroke-width=(width) stroke-linecap=(cap)
                stroke-linejoin="round" stroke-dasharray=[dashes] {}
        }
    }
}

/// Class that gives a series its colour.
fn class(index: usize, series: &Series) -> String {
    match series.name.as_str() {
        colour @ ("red" | "green" | "blue") => format!("series {colour}"),
        _ => format!("series s{}", index % COLOURS),
    }
}

fn legend(series: &[Series]) -> Markup {
    html! {
        @if series.iter().any(|series| !series.name.is_empty()) {
            ul class="legend" {
                @for (index, series) in series.iter().enumerate() {
                    li { (key(index, series)) (printable(&series.name)) }
                }
            }
        }
    }
}

fn key(index: usize, series: &Series) -> Markup {
    let mut path = Path::default();
    match series.style {
        Style::Dots => path.dot([14.0, 6.0]),
        Style::Line | Style::Dashed => {
            path.move_to([2.0, 6.0]);
            path.line_to([26.0, 6.0]);
        }
    }
    html! {
        svg class=(class(index, series)) width="28" height="12" viewBox="0 0 28 12" aria-hidden="true" {
            (stroke(path, series.style, index))
        }
    }
}
