//! Faults of the flash and of power while it is written.

use super::alone;
use super::entry::Entry;

pub fn entries() -> Vec<Entry> {
    vec![
        Entry::alone(
            "brown-out at any instant of the start",
            "3.3 V",
            alone::brown_outs,
        ),
        Entry::alone(
            "power cut at every word of a save",
            "board's supply",
            alone::cuts_of_words,
        ),
        Entry::alone(
            "power cut in an erase",
            "board's supply",
            alone::cuts_of_erases,
        ),
        Entry::alone(
            "flipped bits in stored parameters",
            "flash",
            alone::flipped_bits,
        ),
    ]
}
