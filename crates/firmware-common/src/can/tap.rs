//! Copies of the bus frames of a board, for a host that watches at its serial port.

use core::sync::atomic::{AtomicBool, AtomicU16, Ordering};

use core_algos::bus::CanFrame;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;

/// Frames that wait for the link: three epochs of all boards.
const ROOM: usize = 64;

static WATCHED: AtomicBool = AtomicBool::new(false);
static FRAMES: Channel<CriticalSectionRawMutex, CanFrame, ROOM> = Channel::new();
static LOST: AtomicU16 = AtomicU16::new(0);

/// Copies frames from here on.
pub fn watch() {
    WATCHED.store(true, Ordering::Relaxed);
}

/// True once a host watches.
pub fn is_watched() -> bool {
    WATCHED.load(Ordering::Relaxed)
}

/// Copies a frame, if a host watches.
pub(super) fn copy(frame: &CanFrame) {
    if is_watched() && FRAMES.try_send(*frame).is_err() {
        LOST.fetch_add(1, Ordering::Relaxed);
    }
}

/// The oldest copy that was not taken yet.
pub fn take() -> Option<CanFrame> {
    FRAMES.try_receive().ok()
}

/// Frames that found no room, modulo 65 536.
pub fn lost() -> u16 {
    LOST.load(Ordering::Relaxed)
}
