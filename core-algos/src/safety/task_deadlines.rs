//! Deadlines of a board's tasks: decides whether the watchdog may be fed.
//!
//! A task that stops, or is starved by a task of higher priority, misses its deadline. The watchdog is then not fed,
//! whatever the other tasks do: only the watchdog driver feeds, and only if [`TaskDeadlines::complete`] is true.
//!
//! | condition | reaction | after | until | reason |
//! |---|---|---|---|---|
//! | count of a task unchanged for longer than its deadline | not complete; the first such task is late | the task's deadline, from the start if it never reported | the check at which its count has changed | the task stopped or is starved |
//! | count of a task changed, up or down | the deadline restarts at this check | at once | | counts wrap |
//! | every task within its deadline | complete | at once | | |
//! | clock before the latest change | no time has passed | at once | | no task is late before its deadline |
//!
//! # Panic contract
//!
//! [`TaskDeadlines::new`] takes any times; nothing here can fail.

use crate::time::Micros;

/// Tasks of a board, each with its deadline: the longest time between two reports, µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskDeadlines<const N: usize> {
    within: [Micros; N],
    /// Number of reports at the latest check, and time of its latest change.
    latest: [(u32, Micros); N],
}

impl<const N: usize> TaskDeadlines<N> {
    /// Tasks with these deadlines (µs); each first deadline is measured from `now`.
    pub const fn new(within: [Micros; N], now: Micros) -> Self {
        Self {
            within,
            latest: [(0, now); N],
        }
    }

    /// Checks the number of reports of each task since the start, which may wrap. True if every task is within its
    /// deadline at `now`. If the clock runs back, no time passes.
    pub fn complete(&mut self, now: Micros, reports: [u32; N]) -> bool {
        for (latest, count) in self.latest.iter_mut().zip(reports) {
            if latest.0 != count {
                *latest = (count, now);
            }
        }
        self.late(now).is_none()
    }

    /// The first task that is late at `now`.
    pub fn late(&self, now: Micros) -> Option<usize> {
        let mut tasks = self.latest.iter().zip(self.within);
        tasks.position(|(&(_, last), within)| now.saturating_sub(last) > within)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{prop, prop_assert, prop_assert_eq};

    #[test]
    fn one_silent_task_is_late_while_others_report() {
        for silent in 0..3 {
            let mut call = TaskDeadlines::new([5_000, 20_000, 100_000], 0);
            let mut reports = [u32::MAX - 3; 3];
            let mut refused = None;
            for tick in 1..=300u64 {
                for (task, count) in reports.iter_mut().enumerate() {
                    if task != silent || tick <= 50 {
                        *count = count.wrapping_add(1);
                    }
                }
                if !call.complete(tick * 1_000, reports) {
                    refused.get_or_insert(tick);
                    assert_eq!(call.late(tick * 1_000), Some(silent));
                }
            }
            let within = [5, 20, 100][silent];
            assert_eq!(refused, Some(50 + within + 1));
        }
    }

    #[test]
    fn deadline_restarts_at_each_change_of_the_count() {
        let mut call = TaskDeadlines::new([10_000, 30_000], 1_000_000);
        for (now, counts, late) in [
            (1_010_000, [0, 0], None),
            (1_010_001, [0, 0], Some(0)),
            (1_020_000, [1, 0], None),
            (1_030_000, [1, 0], None),
            (1_030_001, [1, 0], Some(0)),
            (1_030_001, [2, 0], Some(1)),
            (1_040_002, [2, 0], Some(0)),
            // Any change of the count restarts the deadline, also a decrease.
            (1_040_003, [1, 7], None),
            (1_040_003, [0, 7], None),
            (1_000_000, [0, 7], None),
            (1_050_003, [0, 7], None),
            (1_050_004, [0, 7], Some(0)),
            (1_070_003, [u32::MAX, 7], None),
            (1_070_004, [u32::MAX, 7], Some(1)),
        ] {
            assert_eq!(call.complete(now, counts), late.is_none(), "{now}");
            assert_eq!(call.late(now), late, "{now}");
        }
    }

    properties! {
        /// Compares with the plain definition, for random times of reports and checks.
        #[test]
        fn complete_means_every_task_within_its_deadline(
            events in prop::collection::vec((0usize..4, 1u64..4_000), 1..200),
        ) {
            let within = [1_000, 5_000, 30_000];
            let mut call = TaskDeadlines::new(within, 0);
            let (mut now, mut counts) = (0, [0u32; 3]);
            // A report counts from the next check.
            let (mut pending, mut last) = ([false; 3], [0u64; 3]);
            for (event, later) in events {
                now += later;
                if let Some(count) = counts.get_mut(event) {
                    *count += 1;
                    pending[event] = true;
                    continue;
                }
                for task in 0..3 {
                    if core::mem::take(&mut pending[task]) {
                        last[task] = now;
                    }
                }
                let all = (0..3).all(|task| now - last[task] <= within[task]);
                prop_assert_eq!(call.complete(now, counts), all);
                prop_assert!(call.late(now).is_none() == all);
            }
        }
    }
}
