//! Faults of the flash, and power failures during writes.

use super::board_trials;
use super::entry::{Entry, entries};

pub fn entries() -> Vec<Entry> {
    entries! {
        "brown-out at any instant of the start", "3.3 V", board_trial(board_trials::brown_outs);
        "power cut at every word of a save", "board's supply", board_trial(board_trials::cuts_of_words);
        "power cut in an erase", "board's supply", board_trial(board_trials::cuts_of_erases);
        "flipped bits in stored parameters", "flash", board_trial(board_trials::flipped_bits);
    }
}
