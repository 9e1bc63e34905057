//! Where the boards' time went: by function and by interrupt, with the longest of each interrupt.

use crate::virtual_robot::{BoardReport, VirtualRobot};
use serde::Serialize;
use virtual_board::probe::profile::{InterruptTime, Times};

/// A function.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Function {
    /// Its name.
    pub name: String,
    /// Time in it, without what it called, µs.
    pub us: f64,
}

/// An interrupt or another exception.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Interrupt {
    /// Name of its handler.
    pub name: String,
    /// Number of calls.
    pub count: u64,
    /// Time of all of them, without what preempted them, µs.
    pub us: f64,
    /// The longest without what preempted it, µs.
    pub longest_us: f64,
    /// The longest from entry to return, with what preempted it, µs.
    pub longest_with_preemption_us: f64,
    /// The longest from pending to the first instruction, µs.
    pub longest_latency_us: f64,
}

/// Time of a board by function since power on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Profile {
    /// The board.
    pub board: &'static str,
    /// Functions, the one that took most first.
    pub functions: Vec<Function>,
    /// Interrupts, the one that took most first.
    pub interrupts: Vec<Interrupt>,
    /// Most stack that was in use, bytes.
    pub stack_used: Option<u32>,
    /// Size of the stack, bytes.
    pub stack_size: Option<u32>,
    /// Folded stacks for flame graphs.
    #[serde(skip)]
    pub folded: String,
    /// As tables.
    #[serde(skip)]
    pub table: String,
}

/// The profiles of a robot's boards; none was taken unless
/// [`Options::profile`](crate::virtual_robot::Options::profile) asked for it.
pub fn of(robot: &mut VirtualRobot, reports: &[BoardReport]) -> Vec<Profile> {
    let mut profiles = Vec::new();
    let boards = robot.roles.iter().zip(robot.network.boards());
    for (((&role, board), watch), report) in boards.zip(&robot.watches).zip(reports) {
        let hclk_hz = watch.hclk_hz() as f64;
        let Some(times) = Times::of(robot.images.of(role), board, hclk_hz) else {
            continue;
        };
        let us = |cycles: u64| cycles as f64 / times.frequency_hz() * 1e6;
        let functions = times.functions().iter().map(|function| Function {
            name: function.name.clone(),
            us: us(function.cycles),
        });
        let interrupt = |InterruptTime { name, times }: &InterruptTime| Interrupt {
            name: name.clone(),
            count: times.count,
            us: us(times.total),
            longest_us: us(times.longest_own),
            longest_with_preemption_us: us(times.longest),
            longest_latency_us: us(times.longest_latency),
        };
        let name = robot.topology.name(role);
        profiles.push(Profile {
            board: name,
            functions: functions.collect(),
            interrupts: times.interrupts().iter().map(interrupt).collect(),
            stack_used: report.stack_used,
            stack_size: report.stack_size,
            folded: times.folded(name),
            table: format!("{name} board\n{times}"),
        });
    }
    profiles
}
