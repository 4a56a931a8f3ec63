//! How far a command has come, drawn on standard error: a bar or a spinner, and nothing at all where that is no terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use mirrorball_calib::least_squares::arrow::Iteration;

/// Time between two turns of the spinner, so that a person sees that a long step has not hung.
const SPIN: Duration = Duration::from_millis(120);

/// A line that says what is being done; it goes away when this is dropped.
#[derive(Debug)]
pub(crate) struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// Pictures being looked at: a bar where their number is known.
    pub(crate) fn pictures(expected: Option<usize>) -> Self {
        match expected {
            Some(n) => Self::new(
                Some(n as u64),
                "{wide_bar:.blue} {pos} of {len} pictures, {eta} left  {msg}",
            ),
            None => Self::new(None, "{spinner} {pos} pictures in {elapsed}  {wide_msg}"),
        }
    }

    /// A solve.
    pub(crate) fn solve(what: &str) -> Self {
        let progress = Self::new(None, "{spinner} {prefix}, {elapsed}  {wide_msg}");
        progress.bar.set_prefix(what.to_owned());
        progress
    }

    /// No line at all.
    pub(crate) fn hidden() -> Self {
        Self {
            bar: ProgressBar::hidden(),
        }
    }

    fn new(length: Option<u64>, template: &str) -> Self {
        // Hides itself where standard error is no terminal.
        let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::stderr());
        bar.set_style(ProgressStyle::with_template(template).expect("a constant that is a template"));
        bar.enable_steady_tick(SPIN);
        Self { bar }
    }

    /// One more picture has been looked at.
    pub(crate) fn tick(&self, name: &str) {
        self.bar.set_message(name.to_owned());
        self.bar.inc(1);
    }

    /// An iteration of the solve is done.
    pub(crate) fn iteration(&self, iteration: &Iteration) {
        self.bar
            .set_message(format!("iteration {}, cost {:.6e}", iteration.number, iteration.cost));
    }

    /// Says what a person should do or know now, beside the bar.
    pub(crate) fn say(&self, text: &str) {
        self.bar.set_message(text.to_owned());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_counts_and_takes_any_text() {
        for expected in [None, Some(0), Some(2)] {
            let progress = Progress::pictures(expected);
            for name in ["a.png", "{} {msg}", "\u{1b}[2J"] {
                progress.tick(name);
            }
            assert_eq!(progress.bar.position(), 3);
            progress.say("tilt the board");
            assert_eq!(progress.bar.message(), "tilt the board");
        }
        let solve = Progress::solve("lens");
        solve.iteration(&Iteration { number: 3, cost: 0.25 });
        assert_eq!(solve.bar.message(), "iteration 3, cost 2.500000e-1");
        assert_eq!(solve.bar.prefix(), "lens");
    }
}
