//! Colours side by side, without a gap: the eye finds small differences along an edge only.

use maud::{Markup, html};

use super::{
    super::text::printable,
    colour_scale::encoded,
    frame::WIDTH,
    svg::{drawing, number, text_width},
};

/// Height of a patch.
const HEIGHT: f64 = 26.0;

/// Distance between rows.
const PITCH: f64 = 30.0;

/// Largest width of a patch.
const MAX_WIDTH: f64 = 150.0;

/// Rows of patches under the names of the columns.
pub(super) fn draw(name: &str, columns: &[String], rows: &[(String, Vec<[f64; 3]>)]) -> Markup {
    let labels = rows.iter().map(|(row, _)| text_width(row));
    let left = (labels.fold(0.0, f64::max) + 12.0).min(0.35 * WIDTH);
    let n_columns = rows
        .iter()
        .map(|(_, colours)| colours.len())
        .fold(columns.len(), usize::max);
    let width = ((WIDTH - left) / n_columns.max(1) as f64).min(MAX_WIDTH);
    let x = |column: usize| left + column as f64 * width;
    let top = |row: usize| 24.0 + row as f64 * PITCH;
    let content = html! {
        g text-anchor="middle" {
            @for (index, column) in columns.iter().enumerate() {
                text x=(number(x(index) + 0.5 * width)) y="15" { (printable(column)) }
            }
        }
        @for (index, (row, colours)) in rows.iter().enumerate() {
            text text-anchor="end" x=(number(left - 8.0)) y=(number(top(index) + 17.0)) { (printable(row)) }
            @for (column, colour) in colours.iter().enumerate() {
                (patch([x(column), top(index)], width, *colour))
            }
        }
    };
    drawing(name, [WIDTH, top(rows.len()) + 4.0], &content)
}

fn patch([x, y]: [f64; 2], width: f64, colour: [f64; 3]) -> Markup {
    let fill = encoded(colour);
    html! {
        rect x=(number(x)) y=(number(y)) width=(number(width)) height=(number(HEIGHT)) shape-rendering="crispEdges"
            fill=(fill.as_deref().unwrap_or("none")) stroke=[fill.is_none().then_some("currentColor")]
            stroke-dasharray=[fill.is_none().then_some("3 3")] {
            title { (fill.as_deref().unwrap_or("no colour")) }
        }
    }
}
