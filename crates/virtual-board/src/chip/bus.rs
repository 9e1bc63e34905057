//! Accesses by the core and by DMA: address decoding, and checks of the program's accesses.

use super::cause::Cause;
use super::effect::Request;
use super::map::Unit;
use super::{CCM, CCM_LENGTH, Chip, FLASH, SRAM, SRAM_LENGTH, dma, map, rcc, register};
use crate::core::{BusError, System, Transfer, Width};
use crate::finding::FindingKind;
use crate::time::{Cycles, NEVER};

/// Reads a little-endian value; zero if it ends beyond `bytes`.
#[inline]
pub(super) fn get(bytes: &[u8], at: usize, width: Width) -> u32 {
    match width {
        Width::Byte => bytes.get(at).copied().unwrap_or(0).into(),
        Width::Half => bytes
            .get(at..at + 2)
            .map_or(0, |b| u16::from_le_bytes([b[0], b[1]]).into()),
        Width::Word => bytes
            .get(at..at + 4)
            .map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
    }
}

/// Writes a little-endian value; no effect if it ends beyond `bytes`.
#[inline]
pub(super) fn put(bytes: &mut [u8], at: usize, width: Width, value: u32) {
    match width {
        Width::Byte => {
            if let Some(place) = bytes.get_mut(at) {
                *place = value as u8;
            }
        }
        Width::Half => {
            if let Some(place) = bytes.get_mut(at..at + 2) {
                place.copy_from_slice(&(value as u16).to_le_bytes());
            }
        }
        Width::Word => {
            if let Some(place) = bytes.get_mut(at..at + 4) {
                place.copy_from_slice(&value.to_le_bytes());
            }
        }
    }
}

impl Chip {
    /// Serves a DMA request of a peripheral.
    pub(super) fn serve(&mut self, request: Request) {
        if self.injected_faults.dma_waits {
            return;
        }
        for (controller, unit) in [
            (dma::Controller::Dma1, Unit::Dma1),
            (dma::Controller::Dma2, Unit::Dma2),
        ] {
            let Some(stream) = self.units.dma(controller).assigned_stream(request) else {
                continue;
            };
            let gate = unit.gate(0);
            if gate.is_some_and(|(register, bit)| !self.units.rcc.is_enabled(register, bit)) {
                continue;
            }
            if self.serve_by(controller, stream) && request == Request::Adc1 {
                self.units.adc.block_ended();
            }
        }
    }

    /// Transfers one item of a DMA stream. True if a block ended.
    fn serve_by(&mut self, controller: dma::Controller, stream: usize) -> bool {
        let (from, to, width) = self.units.dma(controller).item(stream);
        let value = self.dma_read(from, width);
        let fails = std::mem::take(&mut self.injected_faults.dma_error);
        let value = if fails { Err(BusError) } else { value };
        let done = value.and_then(|value| self.dma_write(to, width, value));
        let (units, shared) = (&mut self.units, &mut self.shared);
        let dma = units.dma(controller);
        dma.moved(stream, done.is_ok(), shared)
    }

    /// Repeats pending DMA requests after a write to a DMA controller.
    fn dma_written(&mut self) {
        let (units, shared) = (&mut self.units, &mut self.shared);
        units.adc.request_dma(shared);
        units.usart3.request_dma(shared);
        self.settle();
    }

    fn dma_read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        match Unit::at(address) {
            Some((unit, offset)) => Ok(self.read_register(unit, offset, width)),
            None => self.memory_read(address, width),
        }
    }

    fn dma_write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        match Unit::at(address) {
            Some((unit, offset)) => {
                self.write_register(unit, offset, width, value);
                Ok(())
            }
            // Only the core reaches the core-coupled memory.
            None if address >= SRAM => self.memory_write(address, width, value),
            None => Err(BusError),
        }
    }

    fn memory(&mut self, address: u32) -> Option<(&mut Vec<u8>, usize)> {
        let at = address.wrapping_sub(SRAM) as usize;
        if at < SRAM_LENGTH {
            return Some((&mut self.sram, at));
        }
        let at = address.wrapping_sub(CCM) as usize;
        (at < CCM_LENGTH).then_some((&mut self.ccm, at))
    }

    fn memory_read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        if let Some(value) = self.flash.peek(address, width) {
            return Ok(value);
        }
        let (bytes, at) = self.memory(address).ok_or(BusError)?;
        Ok(get(bytes, at, width))
    }

    fn memory_write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        let (bytes, at) = self.memory(address).ok_or(BusError)?;
        put(bytes, at, width, value);
        Ok(())
    }

    /// Checks an access; true if the access takes effect. After a failure of the supply the result is false: the core
    /// is held in reset and receives no answer.
    fn check_access(
        &mut self,
        unit: Unit,
        offset: u32,
        width: Width,
        write: Option<(u32, u32)>,
    ) -> bool {
        if self.sagged.is_some() {
            return false;
        }
        if let Some((register, bit)) = unit.gate(offset) {
            let rcc = &self.units.rcc;
            let off = !rcc.is_enabled(register, bit);
            if off || rcc.is_in_reset(register, bit) {
                let (kind, what) = if off {
                    (FindingKind::ClockGated, "its clock is off")
                } else {
                    (FindingKind::Forbidden, "the program holds it in reset")
                };
                let text = format!("{}: {what}", unit.name_at(offset));
                self.shared.note(kind, text);
                return false;
            }
        }
        let place = unit.register_offset(offset) & !3;
        let (peripheral, shared) = self.unit(unit);
        let Some(register) = register::find(peripheral.registers(), place) else {
            let text = format!("{}: no register at {place:#x}", unit.name_at(offset));
            shared.note(FindingKind::Unmapped, text);
            return false;
        };
        if width != Width::Word && !register.narrow {
            let text = format!(
                "{}_{}: {} bits wide access",
                unit.name_at(offset),
                register.name,
                8 * width.bytes()
            );
            shared.note(FindingKind::Alignment, text);
        }
        let changed = write.map_or(0, |(value, mask)| register.changed_reserved(value, mask));
        if changed != 0 {
            let text = format!(
                "{}_{}: reserved bits {changed:#010x} written",
                unit.name_at(offset),
                register.name
            );
            shared.note(FindingKind::ReservedBit, text);
        }
        true
    }

    /// Records a finding if an access follows too soon after the peripheral's clock was enabled.
    fn check_enable_delay(&mut self, unit: Unit, offset: u32) {
        let now = self.shared.now;
        let gate = unit.gate(offset);
        if let Some(cycles) = gate.and_then(|gate| self.enabled.is_early(gate, now)) {
            let text = format!(
                "{}: accessed {cycles} cycles after its clock was switched on, without a DSB",
                unit.name_at(offset)
            );
            self.shared.note(FindingKind::Forbidden, text);
        }
    }

    /// Reads a register; the caller delivers the effects of the read on other parts ([`Self::settle`]).
    fn read_register(&mut self, unit: Unit, offset: u32, width: Width) -> u32 {
        if !self.check_access(unit, offset, width, None) {
            return 0;
        }
        let (peripheral, shared) = self.unit(unit);
        peripheral.read(offset & !3, shared) >> (8 * (offset & 3)) & width.mask()
    }

    fn read_unit(&mut self, unit: Unit, offset: u32, width: Width) -> Result<u32, BusError> {
        self.check_enable_delay(unit, offset);
        let value = self.read_register(unit, offset, width);
        self.settle();
        Ok(value)
    }

    /// Writes a register; the caller delivers the effects of the write on other parts ([`Self::settle`]).
    fn write_register(&mut self, unit: Unit, offset: u32, width: Width, value: u32) {
        let shift = 8 * (offset & 3);
        let mask = width.mask() << shift;
        let value = value << shift & mask;
        if !self.check_access(unit, offset, width, Some((value, mask))) {
            return;
        }
        if unit == Unit::Rcc && offset & !3 == rcc::BDCR && !self.units.pwr.is_backup_open() {
            let text = "RCC_BDCR written while PWR_CR.DBP is clear";
            return self.shared.note(FindingKind::Forbidden, text);
        }
        let (peripheral, shared) = self.unit(unit);
        peripheral.write(offset & !3, value, mask, shared);
    }

    fn write_unit(
        &mut self,
        unit: Unit,
        offset: u32,
        width: Width,
        value: u32,
    ) -> Result<(), BusError> {
        self.check_enable_delay(unit, offset);
        let place = offset & !3;
        let enables = unit == Unit::Rcc && rcc::ENABLES.contains(&place);
        let before = enables.then(|| self.units.rcc.enabled_by(place));
        self.write_register(unit, offset, width, value);
        if let Some(before) = before {
            let bits = self.units.rcc.enabled_by(place) & !before;
            self.enabled.switched_on(place, bits, self.shared.now);
        }
        self.settle();
        match unit {
            Unit::Flash | Unit::Pwr => self.check_core_clock(false),
            Unit::Tim1 if matches!(offset & !3, 0x34 | 0x38) && self.units.adc.started() > 0 => {
                let took = self.shared.now.saturating_sub(self.units.adc.started());
                self.longest_reaction = self.longest_reaction.max(took);
            }
            Unit::Rcc => self.gate(),
            Unit::Dma1 | Unit::Dma2 => self.dma_written(),
            _ => {}
        }
        if std::mem::take(&mut self.shared.bus_error) {
            return Err(BusError);
        }
        Ok(())
    }

    /// Handles all events due up to the cycle of an access.
    fn arrive(&mut self, pc: u32, cycle: Cycles) {
        if self.shared.next().1 <= cycle {
            self.catch_up(cycle, cycle);
            self.shared.limit = 0;
        }
        (self.shared.now, self.shared.pc) = (cycle, pc);
    }

    /// True for an address in a peripheral that exists on the chip and is not modelled; records a finding.
    fn is_not_modelled(&mut self, address: u32) -> bool {
        let name = map::not_modelled(address);
        if let Some(name) = name {
            self.shared.note(FindingKind::NotModelled, name);
        }
        name.is_some()
    }

    /// Handles the events due at `cycle` or before; returns the cycle of the next event.
    fn catch_up(&mut self, cycle: Cycles, until: Cycles) -> Cycles {
        loop {
            let (unit, at) = self.shared.next();
            if at > cycle || self.reset.is_some() {
                self.shared.take_sample_by(cycle);
                self.shared.limit = at.min(until);
                return at;
            }
            self.shared.now = at;
            self.shared.schedule(unit, NEVER);
            if unit == Unit::Circuit {
                self.advance_circuit();
            } else {
                let (peripheral, shared) = self.unit(unit);
                peripheral.event(shared);
            }
            self.settle();
        }
    }

    #[inline(never)]
    fn read_elsewhere(&mut self, at: Transfer, cycle: &mut Cycles) -> Result<u32, BusError> {
        if at.address.wrapping_sub(FLASH) < 1 << 20
            && let Some(value) = self.flash.load(at, cycle, &mut self.shared)
        {
            return Ok(value);
        }
        let place = at.address.wrapping_sub(CCM) as usize;
        if place < CCM_LENGTH {
            return Ok(get(&self.ccm, place, at.width));
        }
        self.read_cold(at, cycle)
    }

    #[inline(never)]
    fn write_elsewhere(
        &mut self,
        at: Transfer,
        value: u32,
        cycle: &mut Cycles,
    ) -> Result<(), BusError> {
        let place = at.address.wrapping_sub(CCM) as usize;
        if place < CCM_LENGTH {
            put(&mut self.ccm, place, at.width, value);
            return Ok(());
        }
        self.write_cold(at, value, cycle)
    }

    #[cold]
    #[inline(never)]
    fn read_cold(&mut self, at: Transfer, cycle: &mut Cycles) -> Result<u32, BusError> {
        let Transfer { address, width, pc } = at;
        if let Some((unit, offset)) = Unit::at(address) {
            self.arrive(pc, *cycle);
            *cycle += unit.bus_cycles(&self.shared.clocks);
            return self.read_unit(unit, offset, width);
        }
        if let Some(value) = self.flash.load(at, cycle, &mut self.shared) {
            return Ok(value);
        }
        let found = self.memory_read(address, width);
        if found.is_err() {
            self.arrive(pc, *cycle);
            if self.is_not_modelled(address) {
                return Ok(0);
            }
            self.shared
                .note(FindingKind::Unmapped, format!("read at {address:#010x}"));
        }
        found
    }

    #[cold]
    #[inline(never)]
    fn write_cold(&mut self, at: Transfer, value: u32, cycle: &mut Cycles) -> Result<(), BusError> {
        let Transfer { address, width, pc } = at;
        self.arrive(pc, *cycle);
        if let Some((unit, offset)) = Unit::at(address) {
            *cycle += unit.bus_cycles(&self.shared.clocks);
            let done = self.write_unit(unit, offset, width, value);
            *cycle = (*cycle).max(std::mem::take(&mut self.shared.held_until));
            return done;
        }
        if self.flash.program(at, value, cycle, &mut self.shared) {
            self.settle();
            return Ok(());
        }
        let done = self.memory_write(address, width, value);
        if done.is_err() {
            if self.is_not_modelled(address) {
                return Ok(());
            }
            self.shared
                .note(FindingKind::Unmapped, format!("write at {address:#010x}"));
        }
        done
    }
}

impl System for Chip {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        self.memory_read(address, Width::Half)
            .map(|value| value as u16)
    }

    #[inline]
    fn enter_line(&mut self, address: u32, cycle: &mut Cycles) {
        self.flash.enter_line(address, cycle, &mut self.shared);
    }

    /// SRAM, the target of most accesses, is inlined for each width.
    #[inline(always)]
    fn read(&mut self, at: Transfer, cycle: &mut Cycles) -> Result<u32, BusError> {
        let place = at.address.wrapping_sub(SRAM) as usize;
        if place < SRAM_LENGTH {
            return Ok(get(&self.sram, place, at.width));
        }
        self.read_elsewhere(at, cycle)
    }

    #[inline(always)]
    fn write(&mut self, at: Transfer, value: u32, cycle: &mut Cycles) -> Result<(), BusError> {
        let place = at.address.wrapping_sub(SRAM) as usize;
        if place < SRAM_LENGTH {
            put(&mut self.sram, place, at.width, value);
            return Ok(());
        }
        self.write_elsewhere(at, value, cycle)
    }

    #[inline]
    fn limit(&self) -> Cycles {
        self.shared.limit
    }

    fn advance(&mut self, cycle: Cycles, until: Cycles) -> Cycles {
        self.must_pause = std::mem::take(&mut self.clock_changed);
        self.catch_up(cycle, until)
    }

    fn lines(&self) -> u128 {
        self.shared.lines
    }

    fn take_nmi(&mut self) -> bool {
        std::mem::take(&mut self.nmi)
    }

    fn take_changed_code(&mut self) -> Option<(u32, u32)> {
        self.flash.take_changed()
    }

    fn must_stop(&self) -> bool {
        // A clock change moves the cycle at which the core has to stop.
        self.reset.is_some() || self.must_pause || self.clock_changed || self.sagged.is_some()
    }

    fn synchronise(&mut self) {
        self.enabled.clear();
    }

    fn request_reset(&mut self) {
        self.shared.note(FindingKind::Reset, "by the program");
        self.reset = Some(Cause::Software);
        self.shared.limit = 0;
    }

    fn note(&mut self, kind: FindingKind, pc: u32, cycle: Cycles, text: String) {
        let at = self.shared.base.time_of(cycle);
        self.shared.findings.note(kind, pc, at, text);
    }
}
