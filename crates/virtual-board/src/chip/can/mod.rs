//! CAN controller CAN1 (bxCAN): registers, mailboxes, FIFOs, filters, interrupts.
//!
//! [`crate::wire`] runs the protocol: requests of the program go there as actions, and the bus returns events with
//! their times.
//!
//! Not modelled; enabling one of these is a finding:
//!
//! - silent and loopback modes
//! - single transmission (NART), transmission in the order of requests (TXFP), locked FIFOs (RFLM)
//! - wake-up by the bus
//! - filters other than 32-bit masks
//!
//! Not modelled, without a finding:
//!
//! - the bits RXM, SAMP and RX of MSR, which read as on an idle bus
//! - the freeze while a debugger halts the core (DBF with its bit of DBGMCU)
//! - a clock that is switched off: the controller continues to take part
//!
//! Time stamps are always 0, because the time-triggered mode does not work on this chip.

mod fifo;
mod filter;
mod mailbox;
mod node;
mod registers;

use super::Peripheral;
use super::interrupt::Interrupt;
use super::map::Unit;
use super::register::{Register, merge};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{NEVER, Time};
use crate::wire::{Action, BitTiming, ErrorKind, Event, EventKind, Frame, Settings};
use fifo::{FOVR, FULL, Fifo, RFOM};
use filter::{FINIT, Filters};
use mailbox::{ABRQ, ALST, Mailbox, RQCP, TERR, TXOK};
use registers::*;
use std::collections::VecDeque;

/// Highest bit rate that the controller supports, bit/s.
const MAX_RATE: u64 = 1_000_000;

/// Operating mode of the controller, set by INRQ and SLEEP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Mode {
    #[default]
    Sleep,
    Initialisation,
    Normal,
}

#[derive(Clone, Default)]
pub(crate) struct Can {
    mcr: u32,
    /// Flags ERRI, SLAKI.
    msr: u32,
    ier: u32,
    /// Flags of ESR and the last error code.
    esr: u32,
    btr: u32,
    tec: u8,
    rec: u8,
    /// Acknowledged mode, and the mode to which the controller is changing.
    mode: Mode,
    target: Mode,
    mailboxes: [Mailbox; 3],
    /// Mailbox being transmitted according to the latest event; `None` if no transmission is in progress.
    sending: Option<usize>,
    fifos: [Fifo; 2],
    filters: Filters,
    /// Messages lost because a receive FIFO was full, since the first power-on.
    lost: u64,
    actions: VecDeque<(Time, Action)>,
    events: VecDeque<Event>,
}

impl Can {
    pub fn after_reset() -> Self {
        Self {
            mcr: MCR_RESET,
            btr: 0x0123_0000,
            ..Self::default()
        }
    }

    /// Resets the controller, alone or with the chip. Earlier actions of the program still reach the wire before the
    /// reset.
    pub fn reset(&mut self, shared: &mut Shared) {
        let old = std::mem::replace(self, Self::after_reset());
        (self.actions, self.lost) = (old.actions, old.lost);
        self.act(Action::Reset, shared);
        self.plan(shared);
        self.lines(shared);
    }

    /// Messages lost because a receive FIFO was full, since the first power-on.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    fn act(&mut self, action: Action, shared: &Shared) {
        self.actions.push_back((shared.time(), action));
    }

    fn timing(&self, shared: &Shared) -> BitTiming {
        let btr = self.btr;
        let prescaler = u64::from(btr & 0x3ff) + 1;
        BitTiming {
            quantum: shared.base.fine_period() * prescaler * shared.clocks.apb1,
            segment1: (btr >> 16 & 15) + 1,
            segment2: (btr >> 20 & 7) + 1,
            jump: (btr >> 24 & 3) + 1,
        }
    }

    /// Records a finding if the bit rate exceeds the controller's limit.
    fn check_bit_rate(&self, shared: &mut Shared) {
        let clock = shared.clocks.hclk_hz / shared.clocks.apb1;
        let timing = self.timing(shared);
        let divider = (u64::from(self.btr & 0x3ff) + 1) * u64::from(timing.quanta());
        if clock > MAX_RATE * divider {
            let text = format!(
                "CAN1: {} bit/s: must be at most {MAX_RATE}",
                clock / divider
            );
            shared.note(FindingKind::ClockLimit, text);
        }
    }

    fn settings(&self, shared: &Shared) -> Settings {
        Settings {
            on: self.target == Mode::Normal,
            timing: self.timing(shared),
            recover: self.mcr & ABOM != 0,
            transmit_enabled: true,
            receive_enabled: true,
        }
    }

    fn write_mcr(&mut self, value: u32, shared: &mut Shared) {
        if value & RESET != 0 {
            return self.master_reset(shared);
        }
        let changed = self.mcr ^ value;
        self.mcr = value;
        if changed & value & TTCM != 0 {
            let text = "CAN1: time-triggered mode, which errata sheet ES0182 forbids on this chip";
            shared.note(FindingKind::Forbidden, text);
        }
        if changed & value & (TXFP | RFLM | NART | AWUM) != 0 {
            shared.note(FindingKind::NotModelled, "CAN1: TXFP, RFLM, NART, AWUM");
        }
        let target = self.wanted();
        if target != self.target {
            self.go(target, shared);
        } else if changed & ABOM != 0 && target == Mode::Normal {
            self.act(Action::Set(self.settings(shared)), shared);
        }
    }

    /// Mode requested by INRQ and SLEEP in the present mode.
    fn wanted(&self) -> Mode {
        let (init, sleep) = (self.mcr & INRQ != 0, self.mcr & SLEEP != 0);
        match self.mode {
            Mode::Sleep if sleep => Mode::Sleep,
            _ if init => Mode::Initialisation,
            _ if sleep => Mode::Sleep,
            _ => Mode::Normal,
        }
    }

    /// Starts a change of mode. Leaving the bus waits until the present transmission or reception has ended; joining
    /// the bus takes eleven recessive bits. All other changes are immediate.
    fn go(&mut self, target: Mode, shared: &mut Shared) {
        self.target = target;
        self.events
            .retain(|e| !matches!(e.kind, EventKind::Joined | EventKind::Left));
        self.act(Action::Set(self.settings(shared)), shared);
        if target != Mode::Normal && self.mode != Mode::Normal {
            self.arrive(target);
        }
    }

    fn arrive(&mut self, mode: Mode) {
        if mode == Mode::Sleep && self.mode != Mode::Sleep {
            self.msr |= SLAKI;
        } else if mode != Mode::Sleep {
            self.msr &= !SLAKI;
        }
        self.mode = mode;
    }

    fn master_reset(&mut self, shared: &mut Shared) {
        let (ier, btr) = (self.ier, self.btr);
        let filters = std::mem::take(&mut self.filters);
        self.reset(shared);
        (self.ier, self.btr, self.filters) = (ier, btr, filters);
    }

    fn msr(&self) -> u32 {
        let mode = match self.mode {
            Mode::Sleep => SLAK,
            Mode::Initialisation => INAK,
            Mode::Normal => 0,
        };
        let sending = if self.sending.is_some() { TXM } else { 0 };
        self.msr | mode | sending | RECESSIVE
    }

    fn esr(&self) -> u32 {
        u32::from(self.rec) << 24 | u32::from(self.tec) << 16 | self.esr
    }

    fn write_tsr(&mut self, value: u32, shared: &mut Shared) {
        for k in 0..3 {
            let bits = value >> (8 * k);
            let mailbox = &mut self.mailboxes[k];
            if bits & RQCP != 0 {
                mailbox.flags &= !(RQCP | TXOK | ALST | TERR);
            }
            mailbox.flags &= !(bits & (TXOK | ALST | TERR));
            if bits & ABRQ != 0 && mailbox.is_pending() {
                mailbox.flags |= ABRQ;
                if self.sending != Some(k) {
                    mailbox.complete(0);
                }
                self.act(Action::Abort { mailbox: k as u8 }, shared);
            }
        }
    }

    fn write_mailbox(&mut self, place: u32, value: u32, mask: u32, shared: &mut Shared) {
        let (k, which) = ((place / 16) as usize, (place / 4 % 4) as usize);
        let mailbox = &mut self.mailboxes[k];
        if mailbox.is_pending() {
            let text = format!("CAN1: mailbox {k} written while its request is pending");
            return shared.note(FindingKind::Forbidden, text);
        }
        mailbox.words[which] = merge(mailbox.words[which], value, mask);
        if which == 0 && mailbox.is_pending() {
            mailbox.flags = 0;
            let frame = mailbox.frame();
            let mailbox = k as u8;
            self.act(Action::Request { mailbox, frame }, shared);
        }
    }

    fn write_fifo(&mut self, k: usize, value: u32, shared: &mut Shared) {
        // A release takes two clock cycles of the controller.
        let release = shared.now + 2 * shared.clocks.apb1;
        self.fifos[k].write(value, release);
        self.plan(shared);
    }

    fn write_btr(&mut self, value: u32, shared: &mut Shared) {
        if self.mode != Mode::Initialisation {
            let text = "CAN1_BTR written outside of the initialisation mode";
            return shared.note(FindingKind::Forbidden, text);
        }
        if value & (SILM | LBKM) != 0 {
            shared.note(FindingKind::NotModelled, "CAN1: silent and loopback modes");
        }
        self.btr = value;
    }

    fn write_filter(&mut self, offset: u32, value: u32, shared: &mut Shared) {
        let filters = &mut self.filters;
        let frozen = filters.fmr & FINIT == 0;
        let register = match offset {
            0x200 => {
                filters.fmr = (value & FMR_BITS) | FMR_ONES;
                return;
            }
            0x21c => {
                filters.active = value;
                return;
            }
            0x204 => &mut filters.mode,
            0x20c => &mut filters.scale,
            0x214 => &mut filters.assignment,
            _ => {
                let place = (offset - BANKS) as usize / 4;
                if frozen && filters.active >> (place / 2) & 1 == 1 {
                    let text =
                        format!("CAN1: filter bank {} written while it is active", place / 2);
                    return shared.note(FindingKind::Forbidden, text);
                }
                filters.banks[place / 2][place % 2] = value;
                return;
            }
        };
        if frozen {
            let text = "CAN1: filters set up outside of their initialisation mode";
            return shared.note(FindingKind::Forbidden, text);
        }
        *register = value;
    }

    /// Sets CAN1's four interrupt lines from its flags.
    fn lines(&self, shared: &mut Shared) {
        let enabled = |bit: u32| self.ier & bit != 0;
        let complete = self.mailboxes.iter().any(|m| m.flags & RQCP != 0);
        shared.line(Interrupt::Can1Tx, enabled(TMEIE) && complete);
        for (k, line) in [Interrupt::Can1Rx0, Interrupt::Can1Rx1]
            .into_iter()
            .enumerate()
        {
            let status = self.fifos[k].status();
            let level = enabled(FMPIE[k]) && status & 3 != 0
                || enabled(FFIE[k]) && status & FULL != 0
                || enabled(FOVIE[k]) && status & FOVR != 0;
            shared.line(line, level);
        }
        let change =
            enabled(ERRIE) && self.msr & ERRI != 0 || enabled(SLKIE) && self.msr & SLAKI != 0;
        shared.line(Interrupt::Can1Sce, change);
    }

    /// Schedules the controller's next bus event or FIFO release.
    fn plan(&self, shared: &mut Shared) {
        let event = self.events.front().map(|e| shared.base.cycle_of(e.at));
        let releases = self.fifos.iter().map(|fifo| fifo.release);
        let at = releases.chain(event).min().unwrap_or(NEVER);
        if shared.due(Unit::Can1) != at {
            shared.schedule(Unit::Can1, at);
        }
    }

    /// Queues an event that the bus reports; the controller handles it at its time.
    pub fn post(&mut self, event: Event, shared: &mut Shared) {
        self.events.push_back(event);
        if self.events.len() == 1 {
            self.plan(shared);
        }
    }

    fn handle_event(&mut self, event: Event, shared: &mut Shared) {
        let Event { kind, tec, rec, .. } = event;
        match kind {
            EventKind::Joined if self.target == Mode::Normal => {
                self.arrive(Mode::Normal);
                self.check_bit_rate(shared);
            }
            EventKind::Left if self.target != Mode::Normal => self.arrive(self.target),
            EventKind::Joined | EventKind::Left | EventKind::Counted => {}
            EventKind::Started { mailbox } => self.sending = Some(mailbox.into()),
            EventKind::Sent { mailbox, .. } => {
                self.sending = None;
                self.esr &= !LEC;
                if let Some(mailbox) = self.mailboxes.get_mut(usize::from(mailbox)) {
                    mailbox.complete(TXOK);
                }
            }
            EventKind::Failed {
                mailbox,
                lost,
                again,
            } => self.failed(mailbox.into(), lost, again),
            EventKind::Received { frame, .. } => {
                self.esr &= !LEC;
                self.receive(&frame, shared);
            }
            EventKind::Error(kind) => self.error(kind),
            EventKind::Off => self.raise(BOFF, BOFIE),
            EventKind::Recovered => self.esr &= !BOFF,
        }
        self.count(tec, rec);
    }

    fn failed(&mut self, mailbox: usize, lost: bool, again: bool) {
        self.sending = None;
        if let Some(mailbox) = self.mailboxes.get_mut(mailbox)
            && mailbox.is_pending()
        {
            let flag = if lost { ALST } else { TERR };
            if again {
                mailbox.flags = mailbox.flags & !(ALST | TERR) | flag;
            } else {
                mailbox.complete(flag);
            }
        }
    }

    fn error(&mut self, kind: ErrorKind) {
        let code = match kind {
            ErrorKind::Stuff => 1,
            ErrorKind::Form => 2,
            ErrorKind::Acknowledgement => 3,
            ErrorKind::BitRecessive => 4,
            ErrorKind::BitDominant => 5,
            ErrorKind::Crc => 6,
        };
        self.esr = self.esr & !LEC | code << 4;
        if self.ier & LECIE != 0 {
            self.msr |= ERRI;
        }
    }

    /// Sets a flag of ESR; a rising flag raises ERRI if its interrupt is enabled.
    fn raise(&mut self, flag: u32, enable: u32) {
        if self.esr & flag == 0 && self.ier & enable != 0 {
            self.msr |= ERRI;
        }
        self.esr |= flag;
    }

    fn count(&mut self, tec: u8, rec: u8) {
        (self.tec, self.rec) = (tec, rec);
        let highest = tec.max(rec);
        for (flag, enable, limit) in [(EWGF, EWGIE, 96), (EPVF, EPVIE, 128)] {
            if highest >= limit {
                self.raise(flag, enable);
            } else {
                self.esr &= !flag;
            }
        }
    }

    fn receive(&mut self, frame: &Frame, shared: &mut Shared) {
        let Some(found) = self.filters.find(frame) else {
            return;
        };
        let mut data = [0; 8];
        data[..frame.data().len()].copy_from_slice(frame.data());
        let data = u64::from_le_bytes(data);
        let control = u32::from(found.index) << 8 | u32::from(frame.code());
        let message = [
            filter::wide(frame),
            control,
            data as u32,
            (data >> 32) as u32,
        ];
        if self.fifos[found.fifo].push(message) {
            self.lost += 1;
            let text = format!("CAN1: FIFO {} overrun", found.fifo);
            shared.note(FindingKind::Lost, text);
        }
    }
}

impl Peripheral for Can {
    fn registers(&self) -> &'static [Register] {
        &REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.mcr,
            0x04 => self.msr(),
            0x08 => mailbox::status(&self.mailboxes),
            0x0c | 0x10 => self.fifos[(offset as usize - 0x0c) / 4].status(),
            0x14 => self.ier,
            0x18 => self.esr(),
            0x1c => self.btr,
            MAILBOXES..OUTPUTS => {
                let place = (offset - MAILBOXES) as usize;
                self.mailboxes[place / 16].words[place / 4 % 4]
            }
            OUTPUTS..0x1d0 => {
                let place = (offset - OUTPUTS) as usize;
                self.fifos[place / 16].output(place / 4 % 4)
            }
            0x200 => self.filters.fmr,
            0x204 => self.filters.mode,
            0x20c => self.filters.scale,
            0x214 => self.filters.assignment,
            0x21c => self.filters.active,
            BANKS.. => {
                let place = (offset - BANKS) as usize / 4;
                self.filters.banks[place / 2][place % 2]
            }
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x00 => self.write_mcr(merge(self.mcr, value, mask) & MCR_BITS, shared),
            0x04 => self.msr &= !(value & (ERRI | SLAKI)),
            0x08 => self.write_tsr(value, shared),
            0x0c | 0x10 => self.write_fifo(
                (offset as usize - 0x0c) / 4,
                value & (RFOM | FULL | FOVR),
                shared,
            ),
            0x14 => {
                self.ier = merge(self.ier, value, mask) & IER_BITS;
                if self.ier & WKUIE != 0 {
                    shared.note(FindingKind::NotModelled, "CAN1: waking by the bus");
                }
            }
            0x18 => self.esr = merge(self.esr, value & LEC, mask & LEC),
            0x1c => self.write_btr(merge(self.btr, value, mask) & BTR_BITS, shared),
            MAILBOXES..OUTPUTS => self.write_mailbox(offset - MAILBOXES, value, mask, shared),
            OUTPUTS..0x1d0 => {
                shared.note(FindingKind::Forbidden, "CAN1: a receive mailbox written")
            }
            _ => {
                let old = self.read(offset, shared);
                self.write_filter(offset, merge(old, value, mask), shared);
                if self.filters.are_unknown() {
                    let text = "CAN1: filters that are lists or have 16 bits";
                    shared.note(FindingKind::NotModelled, text);
                }
            }
        }
        self.lines(shared);
    }

    fn event(&mut self, shared: &mut Shared) {
        for fifo in &mut self.fifos {
            if fifo.release <= shared.now {
                fifo.released();
            }
        }
        while let Some(&event) = self.events.front() {
            if shared.base.cycle_of(event.at) > shared.now {
                break;
            }
            self.events.pop_front();
            self.handle_event(event, shared);
        }
        self.plan(shared);
        self.lines(shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        if self.target == Mode::Normal {
            self.act(Action::Set(self.settings(shared)), shared);
        }
        self.plan(shared);
    }
}

#[cfg(test)]
mod tests;
