//! Least squares with many unknowns that hardly know each other.

pub mod arrow;
pub mod loss;
