//! Thread that draws on the terminal and reads its keys. The terminal is restored at the end and after a panic.

use super::draw::draw;
use super::view::View;
use host_sim::base::error::Error;
use host_sim::run::keyboard::{Key, Keyboard};
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use remote::interrupt;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::io::{self, ErrorKind};
use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

const PICTURE_PERIOD: Duration = Duration::from_millis(50);

/// Timeout of the wait until the drawing thread ends.
const THREAD_END_TIMEOUT: Duration = Duration::from_secs(1);

/// Terminal that shows a run.
pub struct Terminal {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    view: Mutex<View>,
    keyboard: Keyboard,
    /// True if the run has ended.
    run_has_ended: AtomicBool,
}

impl Terminal {
    /// Takes the terminal and shows `view` until [`Self::show`] replaces it.
    pub fn open(view: View, keyboard: Keyboard) -> Result<Self, Error> {
        super::check()?;
        let terminal = ratatui::try_init().map_err(|error| {
            let _ = ratatui::try_restore();
            Error::Failure(format!("--dashboard: {error}"))
        })?;
        let shared = Arc::new(Shared {
            view: Mutex::new(view),
            keyboard,
            run_has_ended: AtomicBool::new(false),
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

    /// Replaces the view.
    pub fn show(&self, view: View) {
        *self
            .shared
            .view
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = view;
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.shared.run_has_ended.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            let deadline = Instant::now() + THREAD_END_TIMEOUT;
            while !thread.is_finished() && Instant::now() < deadline {
                thread::sleep(PICTURE_PERIOD / 10);
            }
        }
        let _ = ratatui::try_restore();
    }
}

impl Shared {
    fn run(&self, terminal: DefaultTerminal) {
        // Dropping a ratatui terminal panics if the terminal is gone.
        let mut terminal = ManuallyDrop::new(terminal);
        self.draw(&mut terminal);
        let _ = terminal.show_cursor();
    }

    fn draw(&self, terminal: &mut DefaultTerminal) {
        while !self.run_has_ended.load(Relaxed) {
            let next = Instant::now() + PICTURE_PERIOD;
            let mut view = self
                .view
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .clone();
            // A paused run sends no views, so the fields that keys change are updated here.
            view.pace = view.pace.map(|_| self.keyboard.pace());
            view.hand = self.keyboard.drives().then(|| self.keyboard.hand());
            view.idle_stop = self.keyboard.idle_stop();
            let drawn = terminal.draw(|frame| draw(frame, &view)).map(|_| ());
            // Without a terminal the run ends.
            if drawn.and_then(|()| self.listen(next)).is_err() {
                self.keyboard.press(Key::Interrupt);
                return;
            }
        }
    }

    /// Reads keys until the next picture is due.
    fn listen(&self, next: Instant) -> io::Result<()> {
        loop {
            let left = next.saturating_duration_since(Instant::now());
            let has_input = await_input(left)?;
            if !event::poll(Duration::ZERO)? {
                match has_input {
                    true => continue,
                    false => return Ok(()),
                }
            }
            let Event::Key(pressed) = event::read()? else {
                continue;
            };
            let key = key_of(&pressed);
            if matches!(key, Some(Key::End | Key::Interrupt)) && self.keyboard.is_ended() {
                // A second request ends the process at once, because the run has not ended its epoch since the first.
                let _ = ratatui::try_restore();
                interrupt::end_at_once();
            }
            if let Some(key) = key {
                self.keyboard.press(key);
            }
        }
    }
}

/// Waits for terminal input or a signal; false after `limit`. Fails if the terminal is gone, because crossterm would
/// poll forever.
fn await_input(limit: Duration) -> io::Result<bool> {
    let gone = PollFlags::ERR | PollFlags::HUP | PollFlags::NVAL;
    let input = io::stdin();
    let mut watched = [PollFd::new(&input, PollFlags::IN)];
    let limit = Timespec::try_from(limit).unwrap_or_default();
    match poll(&mut watched, Some(&limit)) {
        Err(Errno::INTR) => Ok(true),
        Err(error) => Err(error.into()),
        Ok(_) if watched[0].revents().intersects(gone) => Err(ErrorKind::NotConnected.into()),
        Ok(count) => Ok(count > 0),
    }
}

/// Action of a key; `None` for a key without action.
fn key_of(pressed: &KeyEvent) -> Option<Key> {
    let control = pressed.modifiers.contains(KeyModifiers::CONTROL);
    if pressed.kind == KeyEventKind::Release {
        return None;
    }
    Some(match pressed.code {
        KeyCode::Char('c') if control => Key::Interrupt,
        KeyCode::Char('q' | 'Q') | KeyCode::Esc => Key::End,
        KeyCode::Char('p' | 'P') => Key::Pause,
        KeyCode::Char('.') => Key::Step,
        KeyCode::Char('+') => Key::Faster,
        KeyCode::Char('-') => Key::Slower,
        KeyCode::Up | KeyCode::Char('w' | 'W') => Key::Forward,
        KeyCode::Down | KeyCode::Char('s' | 'S') => Key::Backward,
        KeyCode::Left | KeyCode::Char('a' | 'A') => Key::Left,
        KeyCode::Right | KeyCode::Char('d' | 'D') => Key::Right,
        KeyCode::Char(' ') => Key::Halt,
        KeyCode::Char('c' | 'C') => Key::Clear,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_the_actions_that_the_footer_names() {
        let none = KeyModifiers::NONE;
        for (code, modifiers, expected) in [
            (KeyCode::Char('q'), none, Some(Key::End)),
            (KeyCode::Esc, none, Some(Key::End)),
            (
                KeyCode::Char('c'),
                KeyModifiers::CONTROL,
                Some(Key::Interrupt),
            ),
            (KeyCode::Char('c'), none, Some(Key::Clear)),
            (KeyCode::Up, none, Some(Key::Forward)),
            (KeyCode::Char('A'), none, Some(Key::Left)),
            (KeyCode::Char(' '), none, Some(Key::Halt)),
            (KeyCode::Char('x'), none, None),
            (KeyCode::Enter, none, None),
        ] {
            assert_eq!(key_of(&KeyEvent::new(code, modifiers)), expected);
        }
    }
}
