//! All the light as harmonics: the projection of every texel.

/// The plain projection.
pub use mirrorball_calib::probe::sh::IrradianceSh;
