//! Choice among the controller's three transmit mailboxes.
//!
//! The controller first sends the frame with the lowest identifier, and of equal identifiers the frame in the mailbox
//! with the lowest number (RM0090, 32.7.1). A frame therefore goes to a mailbox above every waiting frame with the
//! same identifier, so that frames of one identifier keep their order. A frame never replaces a waiting frame.
//!
//! Nothing here can fail.

use core_algos::time::Micros;

/// Number of transmit mailboxes of the controller.
pub const COUNT: usize = 3;

/// A frame that waits in a mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiting {
    /// Identifier of the frame.
    pub id: u16,
    /// Time at which the frame was queued, µs.
    pub since: Micros,
}

/// Frames in the three mailboxes; `None` for a free mailbox.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mailboxes([Option<Waiting>; COUNT]);

impl Mailboxes {
    /// Creates the state in which all mailboxes are free.
    pub const fn new() -> Self {
        Self([None; COUNT])
    }

    /// Mailbox for a frame with this identifier; `None` while the frame has to wait.
    pub fn choose(&self, id: u16) -> Option<usize> {
        let same = |waiting: &Option<Waiting>| waiting.is_some_and(|waiting| waiting.id == id);
        let above = self.0.iter().rposition(same).map_or(0, |last| last + 1);
        let mut free = self.0.iter().skip(above).map(Option::is_none);
        free.position(|free| free).map(|place| above + place)
    }

    /// Marks a mailbox as full.
    pub fn fill(&mut self, mailbox: usize, waiting: Waiting) {
        if let Some(place) = self.0.get_mut(mailbox) {
            *place = Some(waiting);
        }
    }

    /// Marks a mailbox as free and returns its frame.
    pub fn release(&mut self, mailbox: usize) -> Option<Waiting> {
        self.0.get_mut(mailbox)?.take()
    }

    /// Mailboxes whose frame is older than `age` at `now`.
    pub fn stale(&self, now: Micros, age: Micros) -> impl Iterator<Item = usize> {
        let old = move |waiting: &Waiting| now.saturating_sub(waiting.since) > age;
        let all = self.0.iter().enumerate();
        all.filter_map(move |(mailbox, waiting)| {
            waiting.as_ref().filter(|w| old(w)).map(|_| mailbox)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// Deterministic random numbers; the tests need variety, not quality.
    struct Random(u64);

    impl Random {
        fn below(&mut self, n: u64) -> u64 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (self.0 >> 33) % n
        }
    }

    /// Model of the controller by the reference manual: the mailbox that it sends next.
    fn next(hardware: &[Option<(u16, u32)>; COUNT]) -> Option<usize> {
        let full = (0..COUNT).filter(|&m| hardware[m].is_some());
        full.min_by_key(|&m| (hardware[m].map(|(id, _)| id), m))
    }

    #[test]
    fn frames_of_one_identifier_leave_in_order_and_none_is_replaced() {
        let mut random = Random(7);
        let (mut mailboxes, mut hardware) = (Mailboxes::new(), [None; COUNT]);
        let mut queue = VecDeque::new();
        let (mut number, mut sent) = (0u32, Vec::new());
        for step in 0..200_000 {
            if queue.len() < 24 && random.below(3) == 0 {
                queue.push_back((random.below(4) as u16, number));
                number += 1;
            }
            while let Some(&(id, number)) = queue.front() {
                let Some(mailbox) = mailboxes.choose(id) else {
                    break;
                };
                assert_eq!(hardware[mailbox], None, "displaced in step {step}");
                hardware[mailbox] = Some((id, number));
                mailboxes.fill(mailbox, Waiting { id, since: 0 });
                queue.pop_front();
            }
            if random.below(3) == 0
                && let Some(mailbox) = next(&hardware)
            {
                let (id, number) = hardware[mailbox].take().expect("full");
                assert_eq!(mailboxes.release(mailbox), Some(Waiting { id, since: 0 }));
                sent.push((id, number));
            }
        }
        assert!(sent.len() > 50_000, "{}", sent.len());
        for id in 0..4 {
            let of_id = sent.iter().filter(|frame| frame.0 == id);
            assert!(of_id.map(|frame| frame.1).is_sorted(), "identifier {id}");
        }
    }

    #[test]
    fn fourth_frame_waits_for_a_free_mailbox() {
        let mut mailboxes = Mailboxes::new();
        for (expected, id) in [0x300, 0x200, 0x100].into_iter().enumerate() {
            assert_eq!(mailboxes.choose(id), Some(expected));
            mailboxes.fill(expected, Waiting { id, since: 0 });
        }
        // Even the most urgent frame replaces no waiting frame.
        assert_eq!(mailboxes.choose(0), None);
        mailboxes.release(1);
        assert_eq!(mailboxes.choose(0), Some(1));
    }

    #[test]
    fn frame_waits_while_its_identifier_is_in_the_last_mailbox() {
        let mut mailboxes = Mailboxes::new();
        mailboxes.fill(2, Waiting { id: 5, since: 0 });
        assert_eq!(mailboxes.choose(5), None);
        assert_eq!(mailboxes.choose(4), Some(0));
        mailboxes.release(2);
        assert_eq!(mailboxes.choose(5), Some(0));
    }

    #[test]
    fn frame_older_than_the_limit_is_stale() {
        let mut mailboxes = Mailboxes::new();
        for (mailbox, since) in [(0, 1_000), (2, 30_000)] {
            mailboxes.fill(mailbox, Waiting { id: 1, since });
        }
        let stale = |now| mailboxes.stale(now, 20_000).collect::<Vec<_>>();
        assert_eq!(stale(0), []);
        assert_eq!(stale(21_000), []);
        assert_eq!(stale(21_001), [0]);
        assert_eq!(stale(50_001), [0, 2]);
    }
}
