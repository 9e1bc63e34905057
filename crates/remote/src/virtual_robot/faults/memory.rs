//! Faults of the flash, and power failures during writes.

use super::alone;
use super::entry::{Entry, entries};

pub fn entries() -> Vec<Entry> {
    entries! {
        "brown-out at any instant of the start", "3.3 V", alone(alone::brown_outs);
        "power cut at every word of a save", "board's supply", alone(alone::cuts_of_words);
        "power cut in an erase", "board's supply", alone(alone::cuts_of_erases);
        "flipped bits in stored parameters", "flash", alone(alone::flipped_bits);
    }
}
