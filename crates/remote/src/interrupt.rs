//! Detection of Ctrl-C and of a closed terminal or pipe.

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

/// Action that runs before [`end_at_once`] ends the program.
type LastAction = Box<dyn FnMut() + Send>;

static LAST_ACTION: Mutex<Option<LastAction>> = Mutex::new(None);

/// Returns a flag that is set by Ctrl-C, SIGTERM or SIGHUP, or once standard output has no reader. A second Ctrl-C or
/// SIGTERM ends the program at once, see [`end_at_once`].
pub fn watch_for_interrupt() -> Result<Arc<AtomicBool>, Error> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    thread::spawn(move || {
        let mut asked = false;
        for signal in signals.forever() {
            set.store(true, Relaxed);
            // SIGHUP never ends the program at once: a closing terminal sends several.
            if signal != SIGHUP && std::mem::replace(&mut asked, true) {
                end_at_once();
            }
        }
    });
    let set = flag.clone();
    thread::spawn(move || {
        if has_lost_readers(&io::stdout()) {
            set.store(true, Relaxed);
        }
    });
    Ok(flag)
}

/// Waits until the last reader of an output is gone. Returns false at once if the output is not a pipe, socket or
/// terminal.
fn has_lost_readers(output: &impl AsFd) -> bool {
    let closed = PollFlags::ERR | PollFlags::HUP;
    loop {
        let mut polled = [PollFd::new(output, PollFlags::empty())];
        match poll(&mut polled, None) {
            Err(Errno::INTR) => {}
            Err(_) => return false,
            Ok(_) => return polled[0].revents().intersects(closed),
        }
    }
}

/// Sets the action that runs before [`end_at_once`] ends the program.
pub fn set_last_action(action: impl FnMut() + Send + 'static) {
    *LAST_ACTION.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(action));
}

/// Removes the action that [`set_last_action`] has set.
pub fn clear_last_action() {
    *LAST_ACTION.lock().unwrap_or_else(PoisonError::into_inner) = None;
}

/// Runs the last action, then ends the program with code 130.
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
    fn pipe_that_loses_its_reader_is_detected() {
        let (reader, writer) = io::pipe().unwrap();
        let watch = thread::spawn(move || has_lost_readers(&writer));
        assert!(!watch.is_finished());
        drop(reader);
        assert!(watch.join().unwrap());
    }
}
