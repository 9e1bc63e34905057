//! Request for a session, in memory that a reset keeps.

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;

use super::Route;

/// Word that requests a session at the next start; random after power-on.
#[unsafe(link_section = ".uninit.SESSION")]
static mut WORD: MaybeUninit<u32> = MaybeUninit::uninit();

/// Takes the route of the requested session; `None` if this start is not for a session.
pub fn take() -> Option<Route> {
    let place = addr_of_mut!(WORD).cast::<u32>();
    // SAFETY: only this module uses the word, and every bit pattern is a number. The read is volatile, because the
    // word was written before the reset.
    unsafe {
        let word = place.read_volatile();
        place.write_volatile(0);
        [Route::Serial, Route::Bus]
            .into_iter()
            .find(|route| *route as u32 == word)
    }
}

/// Resets the board. The board then starts a session over the given route, or drives if `None`.
pub fn restart(session: Option<Route>) -> ! {
    let word = session.map_or(0, |route| route as u32);
    // SAFETY: as in [`take`].
    unsafe { addr_of_mut!(WORD).cast::<u32>().write_volatile(word) };
    cortex_m::peripheral::SCB::sys_reset()
}
