//! Tests across crates: whole programs, carried recordings, every configuration file. One binary, so that it links once.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails where it stands")]

mod bad_input;
mod configs;
mod end_to_end;
mod light;
mod light_bad_input;
mod shadows;
mod simulated;
mod support;
mod two_processes;
