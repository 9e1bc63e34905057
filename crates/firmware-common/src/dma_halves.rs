//! Bookkeeping of a circular buffer that a DMA stream fills and the program reads in halves.
//!
//! The stream sets one flag when the first half is full and another when the second half is full. Each full half is a
//! numbered block. A copied block is valid only if no further block became full during the copy, because the stream
//! then overwrites the copied half.
//!
//! Nothing here can fail.

/// Half of the DMA buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// From the start of the buffer to its middle.
    First,
    /// From the middle of the buffer to its end.
    Second,
}

impl Half {
    /// Index of the half's first element if each half has `block` elements.
    pub const fn begins(self, block: usize) -> usize {
        match self {
            Self::First => 0,
            Self::Second => block,
        }
    }
}

/// Number of blocks that became full since the flags were last read, and the valid half. There is no valid half if
/// both flags are set: the stream may be in either half.
pub const fn full(half_transfer: bool, transfer_complete: bool) -> (u32, Option<Half>) {
    match (half_transfer, transfer_complete) {
        (false, false) => (0, None),
        (true, false) => (1, Some(Half::First)),
        (false, true) => (1, Some(Half::Second)),
        (true, true) => (2, None),
    }
}

/// Delay from `now` until a job of length `lead` must start to end a whole number of periods after `last`. The delay
/// is shorter than a period. All in µs.
pub const fn until_in_phase(now: u64, lead: u64, last: u64, period: u64) -> u64 {
    let end = (now + lead) % period;
    (last % period + period - end) % period
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK: usize = 6;

    /// With a late reader, no accepted block mixes samples of two rounds.
    #[test]
    fn late_reader_accepts_no_torn_block() {
        let (mut taken, mut late) = (0, 0);
        for delay in 0..5 * BLOCK {
            for reading in 1..3 * BLOCK {
                let mut buffer = [0usize; 2 * BLOCK];
                let mut number = 0;
                let mut reader: Option<(u32, usize, usize)> = None;
                let mut copy = [0; BLOCK];
                for sample in 1..40 * BLOCK {
                    // The stream writes a sample and the handler runs at once.
                    let place = (sample - 1) % (2 * BLOCK);
                    buffer[place] = sample;
                    let (blocks, half) = full(place + 1 == BLOCK, place + 1 == 2 * BLOCK);
                    number += blocks;
                    if let Some(half) = half
                        && reader.is_none()
                    {
                        reader = Some((number, half.begins(BLOCK), sample + delay));
                    }
                    // Copying the block takes `reading` samples.
                    let Some((of, begins, from)) = reader else {
                        continue;
                    };
                    let done = sample.saturating_sub(from) * BLOCK / reading;
                    let before = sample.saturating_sub(from + 1) * BLOCK / reading;
                    let now = before.min(BLOCK)..done.min(BLOCK);
                    let from = begins + now.start..begins + now.end;
                    copy[now].copy_from_slice(&buffer[from]);
                    if done < BLOCK {
                        continue;
                    }
                    reader = None;
                    if number == of {
                        taken += 1;
                        let whole = copy.is_sorted() && copy[BLOCK - 1] - copy[0] == BLOCK - 1;
                        assert!(whole, "{copy:?} after {delay}, {reading}");
                    } else {
                        late += 1;
                    }
                }
            }
        }
        assert!(taken > 500 && late > 500, "{taken} {late}");
    }

    #[test]
    fn both_flags_set_name_no_half() {
        assert_eq!(full(true, true), (2, None));
        assert_eq!(full(false, false), (0, None));
    }

    #[test]
    fn job_ends_whole_periods_after_the_last_end() {
        for now in [0, 1, 999, 1000, 123_456_789] {
            for lead in [0, 1, 997, 1000, 2500] {
                for last in [0, 1, 500, 999, 7_654_321] {
                    let wait = until_in_phase(now, lead, last, 1000);
                    assert!(wait < 1000);
                    assert_eq!(
                        (now + wait + lead) % 1000,
                        last % 1000,
                        "{now} {lead} {last}"
                    );
                }
            }
        }
    }
}
