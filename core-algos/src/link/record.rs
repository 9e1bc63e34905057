//! Inputs and outputs of a driving board's nodes, recorded by a host.
//!
//! A board sends entries in the order of its tick: received frames, orders, the tick with samples and torques, sent
//! frames. From [`Entry::Begin`] on, and while no entry is lost, the entries are all inputs of the nodes: a replay is
//! bit-identical.
//!
//! | entry | holds | reason |
//! |---|---|---|
//! | frame | identifier and data; invalid with more than 8 bytes | |
//! | tick | ticks since the latest recorded tick or the beginning, and changes of the counts since the latest recorded counts, all modulo 2³² | small numbers encode short |
//! | tick, torques | both torques, omitted if all their bits are 0 | replay compares bits |
//! | beginning | first tick; the reference is the tick before, with counts of 0 | board and host derive the same reference |
//! | truncated or unknown entry | nothing; decoding ends | the length of the entry is unknown |

use super::order::Order;
use crate::beam::MAX_GAUGES;
use crate::bus::CanFrame;
use crate::node::board::Samples;
use crate::node::{axle, beam};
use crate::time::{Micros, TICK};
use crate::topology::Wheels;
use serde::{Deserialize, Serialize};

/// Largest length of an encoded event, bytes: that of an order that sets the posture.
pub const MAX_ENTRY: usize = 112;

/// Recorded event at a board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Entry<'a> {
    /// Identifier and data of a bus frame that the tick received or the board sent.
    Frame(u16, &'a [u8]),
    /// Tick of the nodes. The nodes received the frames of other boards since the previous tick, and the frames that
    /// they sent at the previous tick.
    Tick {
        /// Ticks since the latest recorded tick, or since the tick before the beginning.
        step: u32,
        /// Samples; counts are changes since the latest recorded counts.
        samples: Samples,
        /// Torques commanded, N m, unless both are zero.
        torque_nm: Option<Wheels<f32>>,
    },
    /// Tick without synchronized time: the nodes did not run, and did not receive the frames since the previous tick.
    Wait,
    /// Order of the board itself, carried out before the next tick.
    Order(Order),
    /// Sequence number of a host's order that was carried out before the next tick.
    Carried(u16),
    /// The nodes restarted.
    Begin {
        /// Next tick, ms.
        tick: u32,
    },
    /// Replay ends here: the nodes no longer match the board's configuration, or an order was refused.
    End,
}

impl<'a> Entry<'a> {
    /// Event of this bus frame.
    pub fn of(frame: &'a CanFrame) -> Self {
        Self::Frame(frame.id, frame.bytes())
    }

    /// Bus frame of the event; `None` for another kind of event, or for more than 8 bytes.
    pub fn frame(&self) -> Option<CanFrame> {
        let Self::Frame(id, bytes) = *self else {
            return None;
        };
        let mut data = [0; 8];
        data.get_mut(..bytes.len())?.copy_from_slice(bytes);
        let length = bytes.len() as u8;
        Some(CanFrame { id, length, data })
    }

    /// Encodes the event into `room`; `None` if the event does not fit.
    pub fn encode<'b>(&self, room: &'b mut [u8]) -> Option<&'b [u8]> {
        postcard::to_slice(self, room).ok().map(|used| &*used)
    }
}

/// Decodes the events of a report. The first undecodable event gives `None` and ends the sequence.
pub fn entries(mut bytes: &[u8]) -> impl Iterator<Item = Option<Entry<'_>>> {
    core::iter::from_fn(move || {
        if bytes.is_empty() {
            return None;
        }
        let (entry, rest) = postcard::take_from_bytes(bytes)
            .map_or((None, &[][..]), |(entry, rest)| (Some(entry), rest));
        bytes = rest;
        Some(entry)
    })
}

/// Latest recorded tick and counts; the next event is encoded by its differences from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reference {
    tick: u32,
    counts: [i32; MAX_GAUGES],
}

impl Reference {
    /// Resets the reference for restarted nodes whose first tick is at `now`.
    pub fn begin(&mut self, now: Micros) -> Entry<'static> {
        let tick = (now / TICK) as u32;
        *self = Self::before(tick);
        Entry::Begin { tick }
    }

    /// Reference for restarted nodes whose first tick is `tick`.
    pub fn before(tick: u32) -> Self {
        Self {
            tick: tick.wrapping_sub(1),
            counts: [0; MAX_GAUGES],
        }
    }

    /// Event of a tick; the tick becomes the reference.
    pub fn tick(
        &mut self,
        now: Micros,
        samples: &Samples,
        torque_nm: Wheels<f32>,
    ) -> Entry<'static> {
        let tick = (now / TICK) as u32;
        let step = tick.wrapping_sub(self.tick);
        self.tick = tick;
        let samples = self.each(samples, |before, count| {
            let since = count.wrapping_sub(*before);
            *before = count;
            since
        });
        let none = torque_nm.map(f32::to_bits) == Wheels::both(0);
        Entry::Tick {
            step,
            samples,
            torque_nm: (!none).then_some(torque_nm),
        }
    }

    /// Tick, ms, and samples of a tick event; the tick becomes the reference.
    pub fn resolve(&mut self, step: u32, samples: &Samples) -> (u32, Samples) {
        self.tick = self.tick.wrapping_add(step);
        let samples = self.each(samples, |before, since| {
            *before = before.wrapping_add(since);
            *before
        });
        (self.tick, samples)
    }

    fn each(&mut self, samples: &Samples, change: impl Fn(&mut i32, i32) -> i32) -> Samples {
        let [left, right, ..] = &mut self.counts;
        match *samples {
            Samples::Axle(axle::Samples {
                encoder: counts, ..
            }) => {
                let encoder = Wheels {
                    left: counts.left.map(|count| change(left, count)),
                    right: counts.right.map(|count| change(right, count)),
                };
                match *samples {
                    Samples::Axle(rest) => Samples::Axle(axle::Samples { encoder, ..rest }),
                    other => other,
                }
            }
            Samples::Beam(rest) => {
                let mut counts = rest.counts;
                for (count, before) in counts.iter_mut().zip(&mut self.counts) {
                    *count = change(before, *count);
                }
                Samples::Beam(beam::Samples { counts, ..rest })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::Estimate;
    use crate::link::order::Placement;
    use crate::math::Posture;
    use crate::safety::{Condition, Conditions};

    #[test]
    fn longest_entries_fit() {
        let sure = Estimate::with_sigmas(Posture::new(1.0, 2.0, 3.0), [0.5; 3]);
        let place = Order::SetPose(Placement {
            center: sure,
            relative: sure,
            floor_drift: 1.0,
        });
        let widest = |samples| Entry::Tick {
            step: u32::MAX,
            samples,
            torque_nm: Some(Wheels::both(1.0)),
        };
        let beam = beam::Samples {
            counts: [i32::MIN; MAX_GAUGES],
            conditions: Condition::ALL
                .into_iter()
                .fold(Conditions::NONE, |all, one| all.with(one, true)),
        };
        let mut longest = 0;
        for entry in [Entry::Order(place), widest(Samples::Beam(beam))] {
            let mut room = [0; MAX_ENTRY];
            let bytes = entry.encode(&mut room).unwrap();
            assert_eq!(entries(bytes).next(), Some(Some(entry)));
            longest = longest.max(bytes.len());
        }
        assert!(longest > MAX_ENTRY - 16, "{longest}");
    }

    fn axle(left: Option<i32>, right: Option<i32>) -> Samples {
        Samples::Axle(axle::Samples {
            encoder: Wheels { left, right },
            gyro_rad_s: Some(0.25),
            acceleration_m_s2: None,
            conditions: Conditions::NONE,
        })
    }

    #[test]
    fn tick_is_encoded_as_differences_and_resolved_exactly() {
        let counts = [9, -9, 2_000_000, 0, 1, 2, 3, 4];
        let moved = [9, -7, i32::MIN, 0, 1, 2, 3, 4];
        let beam = |counts: [i32; MAX_GAUGES]| Samples::Beam(counts.into());
        // Tick and samples; expected step and samples of the entry. The nodes begin at the tick of the first row.
        for rows in [
            &[
                (
                    70_000u64,
                    axle(Some(i32::MAX), Some(-3)),
                    1,
                    axle(Some(i32::MAX), Some(-3)),
                ),
                (70_001, axle(Some(i32::MIN), None), 1, axle(Some(1), None)),
                (70_004, axle(None, Some(-7)), 3, axle(None, Some(-4))),
                (
                    70_005,
                    axle(Some(5), Some(-6)),
                    1,
                    axle(Some(i32::MIN + 5), Some(1)),
                ),
            ][..],
            &[
                (u64::from(u32::MAX), beam(counts), 1, beam(counts)),
                (
                    1 + (1 << 32),
                    beam(moved),
                    2,
                    beam([0, 2, i32::MAX - 1_999_999, 0, 0, 0, 0, 0]),
                ),
            ],
        ] {
            // Ticks before the beginning do not affect the reference.
            let mut board = Reference::default();
            board.tick(5 * TICK, &beam([7; MAX_GAUGES]), Wheels::both(0.0));
            let first = rows[0].0;
            let tick = first as u32;
            assert_eq!(board.begin(first * TICK), Entry::Begin { tick });
            let mut host = Reference::before(tick);
            assert_eq!(board, host);
            for &(tick, samples, step, since) in rows {
                let entry = board.tick(tick * TICK, &samples, [1.0, -2.0].into());
                let expected = Entry::Tick {
                    step,
                    samples: since,
                    torque_nm: Some([1.0, -2.0].into()),
                };
                assert_eq!(entry, expected);
                let mut room = [0; MAX_ENTRY];
                let bytes = entry.encode(&mut room).unwrap();
                assert_eq!(entries(bytes).next(), Some(Some(entry)));
                assert_eq!(host.resolve(step, &since), (tick as u32, samples));
                assert_eq!(board, host);
            }
        }
    }

    #[test]
    fn torques_are_left_out_if_both_are_plus_zero() {
        for (torque, left_out) in [
            ([0.0, 0.0], true),
            ([-0.0, 0.0], false),
            ([0.0, -0.0], false),
            ([0.5, 0.0], false),
            ([0.0, 0.5], false),
            ([1.0, -2.0], false),
        ] {
            let entry = Reference::default().tick(TICK, &axle(None, None), torque.into());
            let Entry::Tick { torque_nm, .. } = entry else {
                panic!("{entry:?}")
            };
            let expected = (!left_out).then_some(torque.map(f32::to_bits));
            assert_eq!(
                torque_nm.map(|both| both.list().map(f32::to_bits)),
                expected
            );
        }
    }

    #[test]
    fn frames_survive_encoding_and_truncated_entry_ends_decoding() {
        let frame = CanFrame {
            id: 0x7ff,
            length: 3,
            data: [1, 2, 3, 0, 0, 0, 0, 0],
        };
        let mut bytes = Vec::new();
        for entry in [Entry::of(&frame), Entry::Wait, Entry::of(&frame)] {
            bytes.extend_from_slice(entry.encode(&mut [0; MAX_ENTRY]).unwrap());
        }
        let frames = entries(&bytes).map(|entry| entry.unwrap().frame());
        assert!(frames.eq([Some(frame), None, Some(frame)]));
        let cut: Vec<_> = entries(&bytes[..bytes.len() - 1]).collect();
        assert_eq!((cut.len(), cut[2]), (3, None));
        assert_eq!(Entry::Frame(1, &[0; 9]).frame(), None);
    }
}
