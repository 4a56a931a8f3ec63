//! Colour between two cameras: the 3×3 matrix that makes one see what the other sees, from patches that both see.
//!
//! [`patches`] says where the patches are on their sheet (a list of one's own beside a marker, or a ColorChecker), [`sample`] reads
//! them from a picture in linear light, [`matching`] solves for the matrix, [`difference`] says how visible what is left is;
//! [`white_balance`] says which white-balance setting of one camera goes with which of the other.
//!
//! **Sheet frame**: that of the marker beside the patches (origin at its centre, x right, y up, metres); of a ColorChecker, origin at
//! the bottom-left corner of the patches of the chart held upright (grey row at the bottom), x right, y up.

pub mod difference;
pub mod matching;
pub mod patches;
pub mod print;
pub mod sample;
pub mod white_balance;
