//! Access to the controller's registers (bxCAN, RM0090 chapter 32).
//!
//! The time-triggered mode stays off: it does not work on this chip (errata sheet ES0182).

use core_algos::bus::CanFrame;
use core_algos::bus::layout::BIT_RATE;
use embassy_stm32::gpio::{AfType, Flex, OutputType, Pull, Speed};
use embassy_stm32::pac::CAN1;
use embassy_stm32::pac::can::regs::{Btr, Fr1, Fr2, Ier, Tdhr, Tdlr};
use embassy_stm32::pac::can::vals::{Ide, Rtr};
use embassy_stm32::peripherals::{self, PB8, PB9};
use embassy_stm32::{Peri, rcc};

use super::bit_timing::BitTiming;
use super::mailboxes::COUNT;
use crate::clock::APB1_HZ;

/// CAN1 is alternate function 9 on both pins.
const ALTERNATE: u8 = 9;

const BIT_TIMING: BitTiming = match BitTiming::new(APB1_HZ, BIT_RATE) {
    Some(timing) => timing,
    None => panic!("no prescaler gives this bit rate"),
};

/// State of the receive FIFO.
pub enum Fifo {
    /// The FIFO holds no frame.
    Empty,
    /// The last frame taken is still being released.
    Releasing,
    /// The FIFO holds at least one frame.
    Frame,
}

/// Sets up the pins and the controller and requests initialisation mode, which [`join`] completes.
pub fn start(
    _can: Peri<'static, peripherals::CAN1>,
    rx: Peri<'static, PB8>,
    tx: Peri<'static, PB9>,
) {
    let (mut rx, mut tx) = (Flex::new(rx), Flex::new(tx));
    // The pull-up reads as recessive while the transceiver has no supply.
    rx.set_as_af_unchecked(ALTERNATE, AfType::input(Pull::Up));
    let fast = AfType::output(OutputType::PushPull, Speed::VeryHigh);
    tx.set_as_af_unchecked(ALTERNATE, fast);
    // Dropping the pins would disconnect them.
    core::mem::forget((rx, tx));

    rcc::enable_and_reset::<peripherals::CAN1>();
    // Leaves sleep and requests initialisation mode, which needs no bus.
    CAN1.mcr().modify(|w| {
        w.set_sleep(false);
        w.set_inrq(true);
        w.set_abom(true);
    });
    accept_all();
    enable_interrupts(true);
}

/// Sets one filter that accepts every identifier into FIFO 0: a mask of 32 zero bits.
fn accept_all() {
    CAN1.fmr().modify(|w| w.set_finit(true));
    CAN1.fs1r().modify(|w| w.set_fsc(0, true));
    CAN1.fb(0).fr1().write_value(Fr1(0));
    CAN1.fb(0).fr2().write_value(Fr2(0));
    CAN1.fa1r().modify(|w| w.set_fact(0, true));
    CAN1.fmr().modify(|w| w.set_finit(false));
}

/// Enables the interrupts of sending and receiving; if `errors`, the error interrupt too.
pub fn enable_interrupts(errors: bool) {
    let mut ier = Ier(0);
    ier.set_tmeie(true);
    ier.set_fmpie(0, true);
    ier.set_fovie(0, true);
    ier.set_lecie(true);
    ier.set_errie(errors);
    CAN1.ier().write_value(ier);
}

/// Sets the bit timing and leaves initialisation mode, once the controller has entered it.
pub fn join() {
    if CAN1.mcr().read().inrq() && CAN1.msr().read().inak() {
        CAN1.btr().write_value(Btr(BIT_TIMING.register()));
        CAN1.mcr().modify(|w| w.set_inrq(false));
    }
}

/// True if the controller takes part in the bus at this moment.
pub fn is_joined() -> bool {
    !CAN1.msr().read().inak() && !is_bus_off()
}

/// True if the controller is bus-off at this moment.
pub fn is_bus_off() -> bool {
    CAN1.esr().read().boff()
}

/// Clears the error flag, so that the next error raises an interrupt.
pub fn clear_error() {
    CAN1.msr().write(|w| w.set_erri(true));
}

/// True if a mailbox is free.
pub fn has_free_mailbox() -> bool {
    (0..COUNT).any(|mailbox| CAN1.tsr().read().tme(mailbox))
}

/// Mailboxes whose frame was sent or aborted, each with true if it was sent; clears their flags.
pub fn take_finished() -> impl Iterator<Item = (usize, bool)> {
    let status = CAN1.tsr().read();
    let finished = (0..COUNT).filter(move |&mailbox| status.rqcp(mailbox));
    finished.map(move |mailbox| {
        // A write of 1 to RQCP also clears the mailbox's other flags.
        CAN1.tsr().write(|w| w.set_rqcp(mailbox, true));
        (mailbox, status.txok(mailbox))
    })
}

/// Asks the controller to abort the frame of a mailbox. A frame already on the wire may still be sent.
pub fn abort(mailbox: usize) {
    CAN1.tsr().write(|w| w.set_abrq(mailbox, true));
}

/// Writes a frame into a mailbox and requests transmission.
pub fn request(mailbox: usize, frame: &CanFrame) {
    let [a, b, c, d, e, f, g, h] = frame.data;
    let registers = CAN1.tx(mailbox);
    registers.tdtr().write(|w| w.set_dlc(frame.length));
    let (low, high) = ([a, b, c, d], [e, f, g, h]);
    registers.tdlr().write_value(Tdlr(u32::from_le_bytes(low)));
    registers.tdhr().write_value(Tdhr(u32::from_le_bytes(high)));
    registers.tir().write(|w| {
        w.set_stid(frame.id);
        w.set_txrq(true);
    });
}

/// State of the FIFO, and true if a frame was lost since the last call.
pub fn fifo() -> (Fifo, bool) {
    let state = CAN1.rfr(0).read();
    // Each write has a single 1, because writing 1 clears a flag.
    if state.fovr() {
        CAN1.rfr(0).write(|w| w.set_fovr(true));
    }
    let fifo = match (state.rfom(), state.fmp()) {
        (true, _) => Fifo::Releasing,
        (false, 0) => Fifo::Empty,
        (false, _) => Fifo::Frame,
    };
    (fifo, state.fovr())
}

/// Takes the frame at the head of the FIFO; `None` if it is not a data frame with an identifier of 11 bits.
pub fn take_frame() -> Option<CanFrame> {
    let frame = first_in_fifo();
    CAN1.rfr(0).write(|w| w.set_rfom(true));
    frame
}

fn first_in_fifo() -> Option<CanFrame> {
    let registers = CAN1.rx(0);
    let head = registers.rir().read();
    if head.ide() != Ide::STANDARD || head.rtr() != Rtr::DATA {
        return None;
    }
    // Length codes of nine and more mean eight bytes.
    let length = registers.rdtr().read().dlc().min(8);
    let low = registers.rdlr().read().0;
    let high = registers.rdhr().read().0;
    let mut data = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
    for byte in data.iter_mut().skip(length.into()) {
        *byte = 0;
    }
    Some(CanFrame {
        id: head.stid(),
        length,
        data,
    })
}
