//! Report of a virtual board after a run.

use core_algos::bus::field::Hash24;
use core_algos::topology::{Role, Topology};
use serde::Serialize;
use virtual_board::board::Board;
use virtual_board::image::Image;
use virtual_board::wire::Statistics;

/// Exception number of the current loop's handler.
const ADC: u16 = 16 + 18;

/// Tick timing, state at the start and identity of a board, observed during a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoardObservations {
    missed_ticks: u8,
    longest_tick_us: u16,
    tick_lateness_us: u16,
    boot_sp: u32,
    boot_lost: u64,
    boot_missed: u8,
    hclk_hz: u64,
    identity: Option<(Hash24, u8)>,
}

impl BoardObservations {
    /// Records a health message of the board.
    pub fn health(&mut self, missed: u8, longest_us: u16, lateness_us: u16) {
        self.missed_ticks = self.missed_ticks.max(missed);
        self.longest_tick_us = self.longest_tick_us.max(longest_us);
        self.tick_lateness_us = self.tick_lateness_us.max(lateness_us);
    }

    /// Records an identity message of the board.
    pub fn identify(&mut self, build: Hash24, schema: u8) {
        self.identity = Some((build, schema));
    }

    /// Records the state of a board that is ready: lowest stack pointer, core frequency, frames abandoned while the
    /// board was alone on the bus, ticks missed until the board was synchronised.
    pub fn booted(&mut self, board: &mut Board, lost: u64) {
        (self.boot_lost, self.boot_missed) = (lost, self.missed_ticks);
        self.boot_sp = board.core().lowest_msp();
        self.hclk_hz = board.chip().clocks().hclk_hz;
    }

    /// Core frequency when the board was ready, Hz; 0 if the board was never ready.
    pub fn hclk_hz(&self) -> u64 {
        self.hclk_hz
    }
}

/// Finding: use of the chip by a board's program that the chip's manual forbids or that is not modelled.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardFinding {
    /// Kind of the finding, as text.
    pub kind: &'static str,
    /// Description of the finding.
    pub text: String,
    /// Function and line of the program at the first occurrence.
    pub place: String,
    /// Time of the first occurrence, s since power-on.
    pub time_s: f64,
    /// Number of occurrences of the finding.
    pub count: u64,
}

/// Bus statistics of a board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Can {
    /// Number of frames sent and acknowledged.
    pub sent: u64,
    /// Number of frames received.
    pub received: u64,
    /// Number of received frames lost due to overruns of the FIFO.
    pub overrun: u64,
    /// Number of frames abandoned unsent after all boards were ready.
    pub lost: u64,
    /// Number of arbitrations lost; the frame is sent later.
    pub arbitrations_lost: u64,
    /// Number of error frames.
    pub error_frames: u64,
}

/// Report of a virtual board after a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardReport {
    /// Name of the board.
    pub name: &'static str,
    /// Resets since power on, with time (s) and cause.
    pub resets: Vec<(f64, &'static str)>,
    /// Findings in the board's program.
    pub findings: Vec<BoardFinding>,
    /// Longest tick, as the board measures it, µs.
    pub longest_tick_us: u16,
    /// Largest lateness of a tick, as the board measures it, µs.
    pub tick_lateness_us: u16,
    /// Ticks missed after all boards were ready.
    pub missed_ticks: u8,
    /// Longest time from the converter's trigger to the new duty cycle, µs; `None` for a board without motors.
    pub longest_current_loop_us: Option<f64>,
    /// Fraction of the time in which the core was awake.
    pub load: f64,
    /// Largest stack use, bytes; `None` if the image has no symbols of the stack.
    pub stack_used: Option<u32>,
    /// Size of the stack, bytes; `None` if the image has no symbols of the stack.
    pub stack_size: Option<u32>,
    /// Largest stack use until the board was ready, bytes; `None` if the image has no symbols of the stack.
    pub boot_stack: Option<u32>,
    /// First digits of the hash of the image's sources, as sent by the board; `None` if the board has not sent them.
    pub build: Option<String>,
    /// Number of instructions executed.
    pub instructions: u64,
    /// Bus statistics of the board.
    pub can: Can,
}

/// Limit of a tick, µs; 15 % of the millisecond are reserve. A beam board takes 0.8 ms to fit the strip.
const TICK_LIMIT_US: u64 = 850;

impl BoardReport {
    /// First problem of the board; `None` without one. Error frames do not count after a power cut (`cut`), which may
    /// interrupt a frame.
    pub fn problem(&self, cut: bool) -> Option<String> {
        let name = self.name;
        if let Some((time_s, cause)) = self.resets.first() {
            return Some(format!("{name} board: reset by {cause} at {time_s:.3} s"));
        }
        if let Some(finding) = self.findings.first() {
            return Some(format!(
                "{name} board: {}: {}, in {}",
                finding.kind, finding.text, finding.place
            ));
        }
        let error_frames = if cut { 0 } else { self.can.error_frames };
        let counts = [
            (
                self.longest_tick_us.into(),
                TICK_LIMIT_US,
                "µs in the longest tick",
            ),
            (self.missed_ticks.into(), 0, "ticks missed"),
            (self.can.overrun, 0, "frames lost by overrun"),
            (self.can.lost, 0, "frames abandoned"),
            (error_frames, 0, "error frames"),
        ];
        let beyond = counts.into_iter().find(|(count, most, _)| count > most);
        beyond.map(|(count, most, what)| {
            format!("{name} board: {count} {what}: must be at most {most}")
        })
    }
}

/// Report of a board with this image.
pub fn of(
    robot: Topology,
    role: Role,
    image: &Image,
    board: &mut Board,
    observations: &BoardObservations,
    can: &Statistics,
) -> BoardReport {
    let top = image.symbol("_stack_start");
    let size = top
        .zip(image.symbol("_stack_end"))
        .map(|(top, end)| top.saturating_sub(end));
    let used = |lowest: u32| top.map(|top| top.saturating_sub(lowest));
    let findings = board.chip().findings().list().iter();
    let findings = findings.map(|finding| BoardFinding {
        kind: finding.kind.name(),
        text: finding.text.clone(),
        place: image.describe(finding.pc),
        time_s: finding.at.seconds(),
        count: finding.count,
    });
    let findings = findings.collect();
    let resets = board.resets().iter();
    let resets = resets
        .map(|reset| (reset.at.seconds(), reset.cause.name()))
        .collect();
    let overrun = board.chip().can_overruns();
    let reaction = board.chip().longest_reaction();
    let reaction_us = reaction as f64 * 1e6 / observations.hclk_hz.max(1) as f64;
    let core = board.core();
    BoardReport {
        name: robot.name(role),
        resets,
        findings,
        longest_tick_us: observations.longest_tick_us,
        tick_lateness_us: observations.tick_lateness_us,
        missed_ticks: observations
            .missed_ticks
            .saturating_sub(observations.boot_missed),
        longest_current_loop_us: (!role.is_beam() && core.taken(ADC) > 0).then_some(reaction_us),
        load: 1.0 - core.asleep() as f64 / core.cycles().max(1) as f64,
        stack_used: used(core.lowest_msp()),
        stack_size: size,
        boot_stack: used(observations.boot_sp),
        build: observations
            .identity
            .map(|(build, _)| format!("{:06x}", build.0)),
        instructions: core.instructions(),
        can: Can {
            sent: can.sent,
            received: can.received,
            overrun,
            lost: can.given_up.saturating_sub(observations.boot_lost),
            arbitrations_lost: can.arbitrations_lost,
            error_frames: can.error_frames,
        },
    }
}
