//! What gdb can do to a board.

use super::access;
use super::registers::{CoreRegisters, CortexM4F};
use crate::board::Board;
use crate::core::{System, Transfer, Width};
use crate::image::{CCM, FLASH, SRAM};
use gdbstub::common::Signal;
use gdbstub::target::ext::base::BaseOps;
use gdbstub::target::ext::base::singlethread::{
    SingleThreadBase, SingleThreadResume, SingleThreadResumeOps, SingleThreadSingleStep,
    SingleThreadSingleStepOps,
};
use gdbstub::target::ext::breakpoints::{
    Breakpoints, BreakpointsOps, HwBreakpoint, HwBreakpointOps, HwWatchpoint, HwWatchpointOps,
    SwBreakpoint, SwBreakpointOps, WatchKind,
};
use gdbstub::target::ext::monitor_cmd::{ConsoleOutput, MonitorCmd, MonitorCmdOps, outputln};
use gdbstub::target::{Target, TargetError, TargetResult};
use std::convert::Infallible;

/// Takes everything away that gdb set, and lets the board run.
pub(super) fn release(board: &mut Board) {
    let state = std::mem::take(&mut board.gdb);
    let core = board.core_mut();
    for address in state.breakpoints {
        core.remove_breakpoint(address);
    }
    for (address, length, access) in state.watchpoints {
        core.remove_watchpoint(address, length, access);
    }
    core.attach_debugger(false);
    board.resume(false);
}

impl Target for Board {
    type Arch = CortexM4F;
    type Error = Infallible;

    fn base_ops(&mut self) -> BaseOps<'_, Self::Arch, Self::Error> {
        BaseOps::SingleThread(self)
    }

    fn support_breakpoints(&mut self) -> Option<BreakpointsOps<'_, Self>> {
        Some(self)
    }

    fn support_monitor_cmd(&mut self) -> Option<MonitorCmdOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadBase for Board {
    fn read_registers(&mut self, registers: &mut CoreRegisters) -> TargetResult<(), Self> {
        *registers = CoreRegisters::of(self.core());
        Ok(())
    }

    fn write_registers(&mut self, registers: &CoreRegisters) -> TargetResult<(), Self> {
        registers.set(self.core_mut());
        Ok(())
    }

    fn read_addrs(&mut self, start: u32, data: &mut [u8]) -> TargetResult<usize, Self> {
        if let Some(bytes) = flash(self, start) {
            let count = bytes.len().min(data.len());
            data[..count].copy_from_slice(&bytes[..count]);
            return Ok(count);
        }
        access_memory(self, start, data, &mut |board, at, bytes| {
            // A clock of its own: the access takes the board no time.
            let mut cycle = board.core().cycles();
            let value = board.chip().read(at, &mut cycle).ok()?;
            bytes.copy_from_slice(&value.to_le_bytes()[..bytes.len()]);
            Some(())
        })
    }

    fn write_addrs(&mut self, start: u32, data: &[u8]) -> TargetResult<(), Self> {
        let mut copy = data.to_vec();
        let written = access_memory(self, start, &mut copy, &mut |board, at, bytes| {
            let mut word = [0; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            let mut cycle = board.core().cycles();
            let value = u32::from_le_bytes(word);
            board.chip().write(at, value, &mut cycle).ok()
        })?;
        if written == data.len() {
            Ok(())
        } else {
            Err(TargetError::NonFatal)
        }
    }

    fn support_resume(&mut self) -> Option<SingleThreadResumeOps<'_, Self>> {
        Some(self)
    }
}

/// The flash from an address on, also where it appears at 0.
fn flash(board: &mut Board, start: u32) -> Option<&[u8]> {
    let length = FLASH.end - FLASH.start;
    let place = if start < length {
        start
    } else {
        start.checked_sub(FLASH.start).filter(|p| *p < length)?
    };
    board.chip().flash().get(place as usize..)
}

/// One access of a width.
type Each<'a> = &'a mut dyn FnMut(&mut Board, Transfer, &mut [u8]) -> Option<()>;

/// Accesses in pieces as wide as they may be; how many bytes that did.
fn access_memory(
    board: &mut Board,
    start: u32,
    data: &mut [u8],
    each: Each<'_>,
) -> TargetResult<usize, Board> {
    let mut done = 0;
    while done < data.len() {
        let address = start.wrapping_add(done as u32);
        let is_memory = SRAM.contains(&address) || CCM.contains(&address);
        // What lies in the core itself is not on the bus.
        let is_peripheral = matches!(address >> 28, 4..=5) || address >> 16 == 0x1fff;
        let is_readable = is_memory || is_peripheral && board.gdb.peripherals;
        if !is_readable {
            break;
        }
        let width = match (address % 4, data.len() - done) {
            (0, 4..) => Width::Word,
            (0 | 2, 2..) => Width::Half,
            _ => Width::Byte,
        };
        let bytes = &mut data[done..done + width.bytes() as usize];
        let pc = board.core().pc();
        if each(board, Transfer { address, width, pc }, bytes).is_none() {
            break;
        }
        done += width.bytes() as usize;
    }
    if done == 0 && !data.is_empty() {
        return Err(TargetError::NonFatal);
    }
    Ok(done)
}

impl SingleThreadResume for Board {
    fn resume(&mut self, _signal: Option<Signal>) -> Result<(), Infallible> {
        Board::resume(self, false);
        Ok(())
    }

    fn support_single_step(&mut self) -> Option<SingleThreadSingleStepOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadSingleStep for Board {
    fn step(&mut self, _signal: Option<Signal>) -> Result<(), Infallible> {
        Board::resume(self, true);
        Ok(())
    }
}

impl Breakpoints for Board {
    fn support_sw_breakpoint(&mut self) -> Option<SwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_breakpoint(&mut self) -> Option<HwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_watchpoint(&mut self) -> Option<HwWatchpointOps<'_, Self>> {
        Some(self)
    }
}

// Both kinds are the core's own: no instruction is ever replaced.
impl SwBreakpoint for Board {
    fn add_sw_breakpoint(&mut self, address: u32, _kind: usize) -> TargetResult<bool, Self> {
        self.gdb.breakpoints.push(address);
        self.core_mut().add_breakpoint(address);
        Ok(true)
    }

    fn remove_sw_breakpoint(&mut self, address: u32, _kind: usize) -> TargetResult<bool, Self> {
        let breakpoints = &mut self.gdb.breakpoints;
        let Some(place) = breakpoints.iter().position(|&a| a == address) else {
            return Ok(false);
        };
        breakpoints.swap_remove(place);
        if !breakpoints.contains(&address) {
            self.core_mut().remove_breakpoint(address);
        }
        Ok(true)
    }
}

impl HwBreakpoint for Board {
    fn add_hw_breakpoint(&mut self, address: u32, kind: usize) -> TargetResult<bool, Self> {
        self.add_sw_breakpoint(address, kind)
    }

    fn remove_hw_breakpoint(&mut self, address: u32, kind: usize) -> TargetResult<bool, Self> {
        self.remove_sw_breakpoint(address, kind)
    }
}

impl HwWatchpoint for Board {
    fn add_hw_watchpoint(
        &mut self,
        address: u32,
        length: u32,
        kind: WatchKind,
    ) -> TargetResult<bool, Self> {
        let kind = access(kind);
        self.gdb.watchpoints.push((address, length, kind));
        self.core_mut().add_watchpoint(address, length, kind);
        Ok(true)
    }

    fn remove_hw_watchpoint(
        &mut self,
        address: u32,
        length: u32,
        kind: WatchKind,
    ) -> TargetResult<bool, Self> {
        let kind = access(kind);
        let wanted = (address, length, kind);
        let watchpoints = &mut self.gdb.watchpoints;
        if let Some(place) = watchpoints.iter().position(|&w| w == wanted) {
            watchpoints.swap_remove(place);
        }
        Ok(self.core_mut().remove_watchpoint(address, length, kind))
    }
}

impl MonitorCmd for Board {
    fn handle_monitor_cmd(
        &mut self,
        command: &[u8],
        mut out: ConsoleOutput<'_>,
    ) -> Result<(), Infallible> {
        match String::from_utf8_lossy(command).trim() {
            "reset" | "reset halt" => {
                self.reset();
                outputln!(out, "reset; stopped at {:#010x}", self.core().pc());
            }
            "time" => {
                let (now, cycles) = (self.now(), self.core().cycles());
                outputln!(out, "{now}, cycle {cycles}");
            }
            "findings" => {
                let findings = self.chip().findings();
                for finding in findings.list() {
                    outputln!(out, "{finding}");
                }
                outputln!(out, "{} findings", findings.list().len());
            }
            "peripherals on" => self.gdb.peripherals = true,
            "peripherals off" => self.gdb.peripherals = false,
            _ => outputln!(
                out,
                "reset, time, findings, peripherals on|off (reading their registers may have effects)"
            ),
        }
        Ok(())
    }
}
