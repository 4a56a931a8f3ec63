//! CPU twins of the passes: plain, slow, obviously right.
