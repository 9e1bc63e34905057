//! The terminal: drawn and listened to by a thread of its own, and given back as it was, after a
//! panic too.

use super::draw::draw;
use super::view::View;
use crate::base::error::Error;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use std::io::{self, IsTerminal};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Time from one picture to the next.
const PICTURE: Duration = Duration::from_millis(50);

/// The terminal while it shows a run.
pub struct Terminal {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    view: Mutex<View>,
    /// The user wants the run to end.
    left: AtomicBool,
    /// The run has ended.
    over: AtomicBool,
}

impl Terminal {
    /// An error if there is no terminal to draw on.
    pub fn check() -> Result<(), Error> {
        match io::stdin().is_terminal() && io::stdout().is_terminal() {
            true => Ok(()),
            false => Err(Error::input(
                "--dashboard: standard input and output must be a terminal; leave it out where they \
                 are a file or a pipe",
            )),
        }
    }

    /// Takes the terminal and shows `view` until there is another one.
    pub fn open(view: View) -> Result<Self, Error> {
        Self::check()?;
        let terminal = ratatui::try_init().map_err(|error| {
            ratatui::restore();
            Error::Failure(format!("--dashboard: {error}"))
        })?;
        let shared = Arc::new(Shared {
            view: Mutex::new(view),
            left: AtomicBool::new(false),
            over: AtomicBool::new(false),
        });
        let thread = {
            let shared = shared.clone();
            thread::spawn(move || shared.run(terminal))
        };
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }

    /// Shows this from now on.
    pub fn show(&self, view: View) {
        *self
            .shared
            .view
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = view;
    }

    /// True if the user ended the run.
    pub fn is_left(&self) -> bool {
        self.shared.left.load(Relaxed)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.shared.over.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            // If it panicked, the hook has told of it.
            let _ = thread.join();
        }
        ratatui::restore();
    }
}

impl Shared {
    fn run(&self, mut terminal: DefaultTerminal) {
        while !self.over.load(Relaxed) {
            let next = Instant::now() + PICTURE;
            let view = self
                .view
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .clone();
            let drawn = terminal.draw(|frame| draw(frame, &view)).map(|_| ());
            // Without a terminal nobody sees the run.
            if drawn.and_then(|()| self.listen(next)).is_err() {
                self.left.store(true, Relaxed);
                return;
            }
        }
    }

    /// Takes in keys until the next picture is due.
    fn listen(&self, next: Instant) -> io::Result<()> {
        loop {
            let left = next.saturating_duration_since(Instant::now());
            if !event::poll(left)? {
                return Ok(());
            }
            if matches!(event::read()?, Event::Key(key) if ends(&key))
                && self.left.swap(true, Relaxed)
            {
                // Asked twice: the run does not get to the end of its epoch.
                ratatui::restore();
                process::exit(130);
            }
        }
    }
}

/// True if the key ends the run.
fn ends(key: &KeyEvent) -> bool {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    let end = match key.code {
        KeyCode::Char('q' | 'Q') | KeyCode::Esc => true,
        KeyCode::Char('c') => control,
        _ => false,
    };
    end && key.kind == KeyEventKind::Press
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn q_escape_and_control_c_end_the_run_and_nothing_else_does() {
        let key = |code, modifiers| KeyEvent::new(code, modifiers);
        let none = KeyModifiers::NONE;
        for code in [KeyCode::Char('q'), KeyCode::Char('Q'), KeyCode::Esc] {
            assert!(ends(&key(code, none)));
        }
        assert!(ends(&key(KeyCode::Char('c'), KeyModifiers::CONTROL)));
        for code in [KeyCode::Char('c'), KeyCode::Char('x'), KeyCode::Enter] {
            assert!(!ends(&key(code, none)));
        }
    }
}
