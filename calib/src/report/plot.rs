//! Data of plots, and their drawing as SVG.

/// What is to be plotted. Values that are not finite are left out.
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
        /// Enlargement.
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
    /// What they are.
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
