//! Robots at the time of the fault: cases with equal options, seed and time of the fault share the run until then.

use super::Campaign;
use super::bench::FaultBench;
use super::entry::RunKind;
use super::outcome::FaultCase;
use crate::virtual_robot::{Options, store};
use host_sim::base::error::Error;
use std::sync::{Mutex, PoisonError};

/// Size of the parameter store in the flash, bytes.
const STORE_BYTES: usize = 3 * (16 << 10);

/// Robot at the time of the fault, and the parameter stores of its boards at the start of the run.
type Robot = (FaultBench, Vec<Vec<u8>>);

/// Contents of the parameter stores of all boards.
pub fn stores(bench: &mut FaultBench) -> Vec<Vec<u8>> {
    let boards = bench.robot.network.boards();
    boards
        .map(|board| board.chip().flash()[store::FIRST..store::FIRST + STORE_BYTES].to_vec())
        .collect()
}

/// Options, seed and time of the fault that several cases share.
struct Group {
    options: Options,
    seed: u64,
    after_ms: u64,
    /// Number of cases that still need the robot, and the robot. The robot is `None` before the first drive and after
    /// the last case.
    state: Mutex<(usize, Option<Robot>)>,
}

impl Group {
    fn of(case: &FaultCase) -> Self {
        Self {
            options: case.entry.options(),
            seed: case.seed,
            after_ms: case.after_ms,
            state: Mutex::default(),
        }
    }

    fn holds(&self, case: &FaultCase) -> bool {
        if (self.seed, self.after_ms) != (case.seed, case.after_ms) {
            return false;
        }
        let (options, own) = (case.entry.options(), &self.options);
        own.late_ms == options.late_ms
            && own.fast_ppb == options.fast_ppb
            && std::ptr::fn_addr_eq(own.vary, options.vary)
    }

    fn drive(&self, campaign: &Campaign) -> Result<Robot, Error> {
        let mut bench = FaultBench::new(campaign, self.options.clone(), self.seed)?;
        let before = stores(&mut bench);
        bench.robot.boot(&self.options)?;
        bench.begin_drive();
        bench.run_for(self.after_ms);
        Ok((bench, before))
    }
}

/// One robot per group of cases: driven for the group's first case and kept until its last.
pub struct SharedRobots(Vec<Group>);

impl SharedRobots {
    /// Groups these cases, each of which asks for its robot once.
    pub fn of(cases: &[FaultCase]) -> Self {
        let mut all = Self(Vec::new());
        for case in cases {
            if !matches!(case.entry.kind, RunKind::Drive(_)) {
                continue;
            }
            let index = all.group_index(case);
            if index == all.0.len() {
                all.0.push(Group::of(case));
            }
            let state = all.0[index].state.get_mut();
            state.unwrap_or_else(PoisonError::into_inner).0 += 1;
        }
        all
    }

    /// Index of a case's group, or the number of groups if there is none. Cases sorted by this index keep few robots
    /// in memory.
    pub fn group_index(&self, case: &FaultCase) -> usize {
        let found = self.0.iter().position(|group| group.holds(case));
        found.unwrap_or(self.0.len())
    }

    /// Robot of a case at the time of the fault.
    pub(super) fn get(&self, campaign: &Campaign, case: &FaultCase) -> Result<Robot, Error> {
        let Some(group) = self.0.get(self.group_index(case)) else {
            return Group::of(case).drive(campaign);
        };
        let mut state = group.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (left, robot) = &mut *state;
        let ready = match robot.take() {
            Some(ready) => ready,
            None => group.drive(campaign)?,
        };
        *left = left.saturating_sub(1);
        if *left > 0 {
            *robot = Some(ready.clone());
        }
        Ok(ready)
    }
}
