//! Progress of long runs, drawn only if standard error is a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal};

/// Bar on standard error that counts finished pieces of work; threads share the bar by reference.
#[derive(Debug)]
pub struct Progress(ProgressBar);

impl Progress {
    /// Bar for `total` pieces of work, named `label`; hidden without a terminal.
    pub fn new(total: usize, label: &'static str) -> Self {
        // One piece has no progress to show.
        let target = if total > 1 && io::stderr().is_terminal() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let style = ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len}, {eta} left")
            .expect("a valid template");
        let bar = ProgressBar::with_draw_target(Some(total as u64), target)
            .with_style(style)
            .with_prefix(label);
        Self(bar)
    }

    /// Counts one finished piece of work.
    pub fn advance(&self) {
        self.0.inc(1);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        // The bar disappears with its owner, on an error too.
        self.0.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_counts_all_threads_and_is_hidden_without_terminal() {
        let progress = Progress::new(100, "trials");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..25).for_each(|_| progress.advance()));
            }
        });
        assert_eq!(progress.0.position(), 100);
        assert_eq!(progress.0.is_hidden(), !io::stderr().is_terminal());
    }
}
