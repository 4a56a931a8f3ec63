//! What a camera does to light, measured: vignetting, noise, black level, true exposures, control latency.
//!
//! Each file measures one thing, from pictures that are easy to take:
//!
//! | file | from | yields |
//! | --- | --- | --- |
//! | [`vignetting`] | an evenly lit sheet, better in several positions | `v1`, `v2` |
//! | [`noise`] | repeated pictures of one still scene | `full_well_e`, `read_noise_e` |
//! | [`black`] | pictures with the lens covered | the code of no light |
//! | [`linearity`] | a bracket | the true exposure of every setting |
//! | [`latency`] | a series in which the setting changes at known frames | frames until a change shows |
//! | [`debevec_malik`] | a bracket | the response as Debevec and Malik find it, to compare with |
//!
//! The response itself is fitted by [`response_fit`](crate::response_fit), before any of these.

pub mod black;
pub mod debevec_malik;
pub mod latency;
pub mod linearity;
pub mod noise;
pub mod vignetting;
