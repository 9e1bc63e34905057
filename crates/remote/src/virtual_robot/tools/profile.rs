//! Execution time of the boards by function and by interrupt, with the longest execution of each interrupt.

use crate::virtual_robot::{BoardReport, VirtualRobot};
use serde::Serialize;
use virtual_board::probe::profile::{InterruptTime, Times};

/// Execution time of a function.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Function {
    /// Name of the function.
    pub name: String,
    /// Time in the function without its callees, µs.
    pub us: f64,
}

/// Execution times of an interrupt or another exception.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Interrupt {
    /// Name of the interrupt's handler.
    pub name: String,
    /// Number of calls of the handler.
    pub count: u64,
    /// Total execution time, without the time in which other handlers preempted this handler, µs.
    pub us: f64,
    /// Longest execution, without the time in which other handlers preempted this handler, µs.
    pub longest_us: f64,
    /// Longest time from entry to return, with preemption, µs.
    pub longest_with_preemption_us: f64,
    /// Longest time from the pending of the interrupt to the first instruction of its handler, µs.
    pub longest_latency_us: f64,
}

/// Execution times of a board since power-on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Profile {
    /// Name of the board.
    pub board: &'static str,
    /// Functions, longest total time first.
    pub functions: Vec<Function>,
    /// Interrupts, longest total time first.
    pub interrupts: Vec<Interrupt>,
    /// Largest stack use, bytes; `None` if the image has no symbols of the stack.
    pub stack_used: Option<u32>,
    /// Size of the stack, bytes; `None` if the image has no symbols of the stack.
    pub stack_size: Option<u32>,
    /// Call stacks with their times in the folded format of flame graph tools.
    #[serde(skip)]
    pub folded: String,
    /// Functions and interrupts as text tables.
    #[serde(skip)]
    pub table: String,
}

/// Profiles of a robot's boards; empty without [`Options::profile`](crate::virtual_robot::Options::profile).
pub fn of(robot: &mut VirtualRobot, reports: &[BoardReport]) -> Vec<Profile> {
    let mut profiles = Vec::new();
    let boards = robot.roles.iter().zip(robot.network.boards());
    for (((&role, board), observed), report) in boards.zip(&robot.observations).zip(reports) {
        let hclk_hz = observed.hclk_hz() as f64;
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
