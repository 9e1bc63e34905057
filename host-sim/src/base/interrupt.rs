//! Ctrl-C.

use crate::base::error::Error;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

/// Action before the program ends at once.
type LastAction = Box<dyn FnMut() + Send>;

static LAST_ACTION: Mutex<Option<LastAction>> = Mutex::new(None);

/// A flag that Ctrl-C sets; a second one ends the program at once, see [`end_at_once`].
pub fn watch_for_interrupt() -> Result<Arc<AtomicBool>, Error> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    thread::spawn(move || {
        for _ in signals.forever() {
            if set.swap(true, Relaxed) {
                end_at_once();
            }
        }
    });
    Ok(flag)
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
