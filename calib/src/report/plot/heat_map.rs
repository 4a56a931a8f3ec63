//! A value per cell of a grid over a picture.

use maud::{Markup, html};

use super::{
    Axis, Scale,
    colour_scale::viridis,
    frame::{Frame, MarkedAxis},
    is_drawable,
    svg::{drawing, number},
    ticks::{Span, short},
    vectors::Picture,
};

/// Cells drawn at most along either side.
const MAX_CELLS: usize = 80;

/// Width of the bar that shows the colours, and its distance from the picture.
const BAR: (f64, f64) = (14.0, 18.0);

/// Steps of colour in that bar.
const BAR_STEPS: usize = 64;

/// Values in rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
}

impl Grid {
    /// A last row that is not whole is filled up with nothing; of a grid too fine to see, blocks of cells become one, with
    /// the mean of their values.
    pub(super) fn new(columns: usize, values: &[f64]) -> Self {
        let columns = columns.clamp(1, values.len().max(1));
        let rows = values.len().div_ceil(columns);
        let value = |column: usize, row: usize| {
            let inside = column < columns;
            let value = values.get(row * columns + column).copied();
            value.filter(|value| inside && is_drawable(*value))
        };
        let block = columns.max(rows).div_ceil(MAX_CELLS).max(1);
        let (n_columns, n_rows) = (columns.div_ceil(block), rows.div_ceil(block));
        let mean = |index: usize| {
            let (column, row) = (index % n_columns * block, index / n_columns * block);
            let cells = (0..block * block).filter_map(|cell| value(column + cell % block, row + cell / block));
            let (sum, count) = cells.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
            if block == 1 { sum / count } else { sum * (1.0 / count) }
        };
        Self {
            columns: n_columns,
            rows: n_rows,
            values: (0..n_columns * n_rows).map(mean).collect(),
        }
    }
}

/// The cells in the picture's rectangle, with a bar that explains the colours.
pub(super) fn draw(name: &str, size_px: [u32; 2], grid: &Grid, value: &Axis) -> Markup {
    let picture = Picture::new(size_px);
    let span = Span::of(value.scale, grid.values.iter().copied());
    // A scale that ends at 0 is read more easily, where that costs little of it.
    let span = match (value.scale, span.place(0.0)) {
        (Scale::Linear, Some(zero)) if (-0.6..0.0).contains(&zero) => span.with(0.0),
        (Scale::Linear | Scale::Logarithmic, _) => span,
    };
    let content = html! {
        (picture.axes())
        g shape-rendering="crispEdges" {
            @for (index, cell) in grid.values.iter().enumerate() {
                @if let Some(place) = span.place(*cell) { (rectangle(&picture.frame, grid, index, place)) }
            }
        }
        (picture.frame.border())
        (bar(&picture.frame, &span, &value.name))
    };
    html! {
        (drawing(name, picture.frame.outer(), &content))
        @if grid.values.iter().any(|cell| span.place(*cell).is_none()) {
            p class="note" { "Cells without a colour have no value." }
        }
    }
}

fn rectangle(frame: &Frame, grid: &Grid, index: usize, place: f64) -> Markup {
    let (width, height) = (frame.width / grid.columns as f64, frame.height / grid.rows as f64);
    let x = frame.left + (index % grid.columns) as f64 * width;
    let y = frame.top + (index / grid.columns) as f64 * height;
    html! {
        rect x=(number(x)) y=(number(y)) width=(number(width)) height=(number(height)) fill=(viridis(place)) {
            title { (short(grid.values[index])) }
        }
    }
}

/// The colours with their values, right of the picture.
fn bar(frame: &Frame, span: &Span, name: &str) -> Markup {
    let left = frame.left + frame.width + BAR.1;
    let bar = Frame {
        left,
        width: BAR.0,
        ..*frame
    };
    let axis = MarkedAxis::new(name, *span, frame.height, 1);
    let step = frame.height / BAR_STEPS as f64;
    let right = left + BAR.0;
    html! {
        g shape-rendering="crispEdges" {
            @for index in 0..BAR_STEPS {
                @let place = (index as f64 + 0.5) / BAR_STEPS as f64;
                @let top = bar.at(0.0, (index + 1) as f64 / BAR_STEPS as f64)[1];
                rect x=(number(left)) y=(number(top)) width=(number(BAR.0)) height=(number(step))
                    fill=(viridis(place)) {}
            }
        }
        (bar.border())
        @for (place, label) in axis.marks().filter(|(_, label)| !label.is_empty()) {
            text x=(number(right + 6.0)) y=(number(bar.at(0.0, place)[1] + 4.0)) { (label) }
        }
        text class="axis" text-anchor="middle" transform=(format!(
            "translate({} {}) rotate(-90)",
            number(right + 20.0 + axis.label_width()),
            number(frame.top + 0.5 * frame.height)
        )) { (axis.title()) }
    }
}
