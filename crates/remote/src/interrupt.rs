//! Ctrl-C, and a terminal or pipe that is closed.

use host_sim::base::error::Error;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::{io, process};

/// Action before the program ends at once.
type LastAction = Box<dyn FnMut() + Send>;

static LAST_ACTION: Mutex<Option<LastAction>> = Mutex::new(None);

/// A flag that Ctrl-C sets, or the reader of standard output when it goes away; a second Ctrl-C ends the program at
/// once, see [`end_at_once`].
pub fn watch_for_interrupt() -> Result<Arc<AtomicBool>, Error> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    thread::spawn(move || {
        let mut asked = false;
        for signal in signals.forever() {
            set.store(true, Relaxed);
            // A terminal that closes sends several.
            if signal != SIGHUP && std::mem::replace(&mut asked, true) {
                end_at_once();
            }
        }
    });
    let set = flag.clone();
    thread::spawn(move || {
        if is_left_alone(&io::stdout()) {
            set.store(true, Relaxed);
        }
    });
    Ok(flag)
}

/// Waits until nobody reads an output any more. False if it is no pipe, socket or terminal.
fn is_left_alone(output: &impl AsFd) -> bool {
    let gone = PollFlags::ERR | PollFlags::HUP;
    loop {
        let mut watched = [PollFd::new(output, PollFlags::empty())];
        match poll(&mut watched, None) {
            Err(Errno::INTR) => {}
            Err(_) => return false,
            Ok(_) => return watched[0].revents().intersects(gone),
        }
    }
}

/// Sets the action that comes before the program ends at once.
pub fn set_last_action(action: impl FnMut() + Send + 'static) {
    *LAST_ACTION.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(action));
}

/// Forgets the action.
pub fn clear_last_action() {
    *LAST_ACTION.lock().unwrap_or_else(PoisonError::into_inner) = None;
}

/// Ends the program with code 130, after the last action.
pub fn end_at_once() -> ! {
    if let Some(action) = &mut *LAST_ACTION.lock().unwrap_or_else(PoisonError::into_inner) {
        action();
    }
    process::exit(130);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pipe_without_reader_is_left_alone() {
        let (reader, writer) = io::pipe().unwrap();
        let watch = thread::spawn(move || is_left_alone(&writer));
        assert!(!watch.is_finished());
        drop(reader);
        assert!(watch.join().unwrap());
    }
}
