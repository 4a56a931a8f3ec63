//! Data of plots, and their drawing as SVG.
//!
//! Routines fill these types. How they look is decided in the modules below, one file per kind of plot.

mod chart;
mod colour_scale;
mod frame;
mod heat_map;
mod patches;
mod svg;
mod thin;
mod ticks;
mod vectors;

use maud::Markup;

/// Largest magnitude that is drawn. What is beyond overflows when axes are laid out, and is left out as if not finite.
const MAX_MAGNITUDE: f64 = 1e300;

/// What is to be plotted. Values that are not finite, or beyond ±1e300, are left out.
#[derive(Debug, Clone, PartialEq)]
pub enum Plot {
    /// Points and lines over two axes.
    Chart {
        /// Name and unit of the horizontal axis.
        x: Axis,
        /// Name and unit of the vertical axis.
        y: Axis,
        /// What is drawn, in this order.
        series: Vec<Series>,
    },
    /// Small vectors at places in a picture, such as residuals, drawn `scale` times as long as they are.
    Vectors {
        /// Width and height of the picture in pixels.
        size_px: [u32; 2],
        /// Place and vector, in pixels.
        vectors: Vec<([f64; 2], [f64; 2])>,
        /// Enlargement; 1 where it is not a finite number above 0.
        scale: f64,
    },
    /// A value per cell of a grid that covers a picture.
    HeatMap {
        /// Width and height of the picture in pixels.
        size_px: [u32; 2],
        /// Cells from left to right.
        columns: usize,
        /// `columns` values per row, rows from the top; not finite where there is none.
        values: Vec<f64>,
        /// Name and unit of the values.
        value: Axis,
    },
    /// Colours side by side: measured, corrected, wanted, say.
    Patches {
        /// Names of the columns.
        columns: Vec<String>,
        /// Name of each row and its colours, encoded sRGB of 0 to 1.
        rows: Vec<(String, Vec<[f64; 3]>)>,
    },
}

/// An axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Name and unit.
    pub name: String,
    /// How values are placed.
    pub scale: Scale,
}

/// How values are placed along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By their logarithm; values of 0 and below are left out.
    Logarithmic,
}

/// Points that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What they are. Series called `red`, `green` and `blue` are drawn in these colours, others in colours of their own.
    pub name: String,
    /// x and y.
    pub points: Vec<[f64; 2]>,
    /// How they are drawn.
    pub style: Style,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// A line through the points.
    Line,
    /// A dashed line: a reference.
    Dashed,
    /// A dot for each point.
    Dots,
}

impl Axis {
    /// An axis with evenly placed values.
    #[must_use]
    pub fn linear(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            scale: Scale::Linear,
        }
    }

    /// An axis with values placed by their logarithm.
    #[must_use]
    pub fn logarithmic(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            scale: Scale::Logarithmic,
        }
    }
}

impl Plot {
    /// The drawing: SVG, and a legend beside it where there is something to explain. `name` says to those who cannot see
    /// it what it shows.
    pub(super) fn draw(&self, name: &str) -> Markup {
        match self {
            Self::Chart { x, y, series } => chart::draw(name, x, y, series),
            Self::Vectors {
                size_px,
                vectors,
                scale,
            } => vectors::draw(name, *size_px, vectors, *scale),
            Self::HeatMap {
                size_px,
                columns,
                values,
                value,
            } => heat_map::draw(name, *size_px, &heat_map::Grid::new(*columns, values), value),
            Self::Patches { columns, rows } => patches::draw(name, columns, rows),
        }
    }
}

/// Whether a value can be drawn.
fn is_drawable(value: f64) -> bool {
    value.abs() <= MAX_MAGNITUDE
}

#[cfg(test)]
mod tests;
