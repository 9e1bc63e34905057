//! The controller's registers (bxCAN, RM0090 chapter 32) and its interrupts.
//!
//! - **Start**: the controller is asked for its initialisation, where alone the bit timing can be
//!   written, and told to join; it does so after eleven recessive bits. Nobody waits for it: on a bus
//!   that is held dominant the board runs, [`is_off`] says so, and it joins when the bus is free.
//! - **Sending**: `CAN1_TX` moves frames from the queue to free mailboxes ([`Mailboxes`]), records when
//!   a `TimeSync` had left, and drops what is older than two epochs, in the queue and in the
//!   controller: on a bus that comes back, an old message must not pass for a new one. A frame that
//!   nobody acknowledges is repeated by the controller until then.
//! - **Receiving**: `CAN1_RX0` empties the FIFO of three frames and stamps each.
//! - **Errors**: `CAN1_SCE` counts the first one between two looks of [`supervise`]; a bus where nobody
//!   acknowledges has one every 0.1 ms. The controller leaves bus-off by itself after 128 times eleven
//!   recessive bits.
//!
//! The time-triggered mode stays off: it does not work on this chip (errata sheet ES0182).

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use core_algos::bus::layout::{BIT_RATE, id};
use core_algos::bus::{self, Message};
use core_algos::time::{EPOCH, Micros};
use critical_section::Mutex;
use embassy_stm32::gpio::{AfType, Flex, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::CAN1;
use embassy_stm32::pac::can::regs::{Btr, Fr1, Fr2, Ier, Tdhr, Tdlr};
use embassy_stm32::pac::can::vals::{Ide, Rtr};
use embassy_stm32::peripherals::{self, PB8, PB9};
use embassy_stm32::{Peri, interrupt as handler, rcc};
use embassy_time::{Duration, Instant, Timer};
use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::StaticCell;

use super::bit_timing::BitTiming;
use super::mailboxes::{COUNT, Mailboxes, Waiting};
use super::service;
use crate::clock::APB1_HZ;
use crate::record;
use crate::task_watchdog::CheckIn;

/// Messages that wait to be sent; an epoch has at most fourteen of one board.
const SENDING: usize = 24;
/// Frames that wait for the next tick; a millisecond has room for nine on the bus.
const ARRIVED: usize = 32;
/// Age at which a message is not worth sending any more, µs: two epochs.
const STALE: Micros = 2 * EPOCH;
/// Time between two looks at the controller.
const LOOK: Duration = Duration::from_millis(5);
/// Time within which the bus reports at least, µs.
pub const REPORTS_WITHIN: Micros = 200_000;
/// Looks at the FIFO in one interrupt; a frame needs 47 µs at least, so it is empty long before.
const FIFO_LOOKS: u32 = 16;
/// CAN1 is alternate function 9 on both pins.
const ALTERNATE: u8 = 9;

const BIT_TIMING: BitTiming = match BitTiming::new(APB1_HZ, BIT_RATE) {
    Some(timing) => timing,
    None => panic!("no prescaler gives this bit rate"),
};

/// Counters of the bus since the start, saturating.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, defmt::Format)]
pub struct Counters {
    /// Messages that could not be encoded.
    pub refused: u16,
    /// Messages that found no room in a queue, or grew too old to be sent.
    pub dropped: u16,
    /// Frames that are no message of this bus.
    pub unknown: u16,
    /// Errors the controller reported, at most one in five milliseconds.
    pub errors: u16,
    /// Times the FIFO was full when a frame came: at least one was lost.
    pub overrun: u16,
}

static COUNTERS: Mutex<Cell<Counters>> = Mutex::new(Cell::new(Counters {
    refused: 0,
    dropped: 0,
    unknown: 0,
    errors: 0,
    overrun: 0,
}));

fn count(which: impl FnOnce(&mut Counters) -> &mut u16) {
    critical_section::with(|cs| {
        let mut counters = COUNTERS.borrow(cs).get();
        let counter = which(&mut counters);
        *counter = counter.saturating_add(1);
        COUNTERS.borrow(cs).set(counters);
    });
}

/// The counters.
pub fn counters() -> Counters {
    critical_section::with(|cs| COUNTERS.borrow(cs).get())
}

/// A frame, and the local time at which it was to be sent or had arrived.
type Timed = (Micros, bus::CanFrame);
/// The handlers' ends of both queues, until each handler takes its own.
static TO_SEND: Mutex<Cell<Option<Consumer<'static, Timed>>>> = Mutex::new(Cell::new(None));
static TO_TAKE: Mutex<Cell<Option<Producer<'static, Timed>>>> = Mutex::new(Cell::new(None));
static SYNC_SENT: Mutex<Cell<Option<Micros>>> = Mutex::new(Cell::new(None));
/// The controller was off the bus and has sent nothing since.
static WAS_OFF: AtomicBool = AtomicBool::new(false);
/// Handlers that ran since the last look.
static RAN: AtomicU32 = AtomicU32::new(0);
const RAN_TX: u32 = 1 << 0;
const RAN_RX0: u32 = 1 << 1;

/// True if the board cannot send: not yet on the bus, bus-off after too many errors, or back on the
/// bus without an acknowledged frame. On a dead bus the controller recovers and goes bus-off again
/// every two milliseconds.
pub fn is_off() -> bool {
    if CAN1.esr().read().boff() {
        WAS_OFF.store(true, Ordering::Relaxed);
    }
    !is_joined() || WAS_OFF.load(Ordering::Relaxed)
}

/// True if the controller takes part in the bus at this moment.
fn is_joined() -> bool {
    !CAN1.msr().read().inak() && !CAN1.esr().read().boff()
}

/// A message and the local time at which its frame ended.
#[derive(Clone, Copy, Debug)]
pub struct Arrived {
    /// Local time, µs.
    pub local: Micros,
    /// The message.
    pub message: Message,
}

/// The board's end for what it sends.
pub struct Sender(Producer<'static, Timed>);

impl Sender {
    /// Puts a message in the queue. What cannot be encoded or finds no room is counted. Gives the
    /// message as the other boards will read it.
    pub fn send(&mut self, message: &Message) -> Option<Message> {
        let Ok(frame) = bus::encode(message) else {
            count(|counters| &mut counters.refused);
            return None;
        };
        record::put_frame(&frame);
        self.put(frame);
        bus::decode(&frame).ok()
    }

    /// Sends the next frame of the link; to be called once a tick.
    pub fn serve(&mut self) {
        if let Some(frame) = service::next() {
            self.put(frame);
        }
    }

    fn put(&mut self, frame: bus::CanFrame) {
        let now = Instant::now().as_micros();
        if self.0.enqueue((now, frame)).is_err() {
            count(|counters| &mut counters.dropped);
        }
        // With all mailboxes full the next one that becomes free tells.
        if (0..COUNT).any(|mailbox| CAN1.tsr().read().tme(mailbox)) {
            interrupt::CAN1_TX.pend();
        }
    }

    /// Local time at which the latest [`Message::TimeSync`] of this board had left the bus.
    pub fn take_sync_sent(&mut self) -> Option<Micros> {
        critical_section::with(|cs| SYNC_SENT.borrow(cs).take())
    }
}

/// The board's end for what arrived.
pub struct Receiver(Consumer<'static, Timed>);

impl Receiver {
    /// The next message, if there is one.
    pub fn take(&mut self) -> Option<Arrived> {
        loop {
            let (local, frame) = self.0.dequeue()?;
            if service::takes(&frame) {
                continue;
            }
            record::put_frame(&frame);
            match bus::decode(&frame) {
                Ok(message) => return Some(Arrived { local, message }),
                Err(_) => count(|counters| &mut counters.unknown),
            }
        }
    }
}

/// Starts the controller and gives the board's two ends. It joins the bus under [`supervise`].
pub fn start(
    _can: Peri<'static, peripherals::CAN1>,
    rx: Peri<'static, PB8>,
    tx: Peri<'static, PB9>,
) -> (Sender, Receiver) {
    let (mut rx, mut tx) = (Flex::new(rx), Flex::new(tx));
    // Recessive while the transceiver has no supply.
    rx.set_as_af_unchecked(ALTERNATE, AfType::input(Pull::Up));
    let fast = AfType::output(OutputType::PushPull, Speed::VeryHigh);
    tx.set_as_af_unchecked(ALTERNATE, fast);
    // Dropped they would be disconnected.
    core::mem::forget((rx, tx));

    // A queue holds one frame less than it has places.
    static SENDING_QUEUE: StaticCell<Queue<Timed, { SENDING + 1 }>> = StaticCell::new();
    static ARRIVED_QUEUE: StaticCell<Queue<Timed, { ARRIVED + 1 }>> = StaticCell::new();
    let (send, to_send) = SENDING_QUEUE.init(Queue::new()).split();
    let (to_take, take) = ARRIVED_QUEUE.init(Queue::new()).split();
    critical_section::with(|cs| {
        TO_SEND.borrow(cs).set(Some(to_send));
        TO_TAKE.borrow(cs).set(Some(to_take));
    });

    rcc::enable_and_reset::<peripherals::CAN1>();
    // Out of sleep and into initialisation, which needs no bus.
    CAN1.mcr().modify(|w| {
        w.set_sleep(false);
        w.set_inrq(true);
        w.set_abom(true);
    });
    accept_all();
    CAN1.ier().write_value(interrupts(true));
    // Above the tick: the handlers take a few microseconds, and the times they record are what the
    // boards' clocks are compared by.
    for interrupt in [interrupt::CAN1_TX, interrupt::CAN1_RX0, interrupt::CAN1_SCE] {
        interrupt.set_priority(Priority::P3);
        // SAFETY: the handlers have their data from the start.
        unsafe { interrupt.enable() };
    }
    (Sender(send), Receiver(take))
}

/// One filter, a mask of 32 bits that asks for nothing, into FIFO 0.
fn accept_all() {
    CAN1.fmr().modify(|w| w.set_finit(true));
    CAN1.fs1r().modify(|w| w.set_fsc(0, true));
    CAN1.fb(0).fr1().write_value(Fr1(0));
    CAN1.fb(0).fr2().write_value(Fr2(0));
    CAN1.fa1r().modify(|w| w.set_fact(0, true));
    CAN1.fmr().modify(|w| w.set_finit(false));
}

/// Enabled interrupts, with or without errors.
fn interrupts(errors: bool) -> Ier {
    let mut ier = Ier(0);
    ier.set_tmeie(true);
    ier.set_fmpie(0, true);
    ier.set_fovie(0, true);
    ier.set_lecie(true);
    ier.set_errie(errors);
    ier
}

/// Looks after what no interrupt tells: the way onto the bus, frames that wait too long, the next
/// error. Both handlers run with every look, and the task reports only if they did.
#[embassy_executor::task]
pub async fn supervise(mut check_in: CheckIn) -> ! {
    loop {
        if RAN.swap(0, Ordering::Relaxed) == RAN_TX | RAN_RX0 {
            check_in.report();
        }
        look();
        Timer::after(LOOK).await;
    }
}

/// Keeps the bus of a board in a session, whose nodes do not take part in it: only frames of the link pass.
#[embassy_executor::task]
pub async fn carry(bus: (Sender, Receiver)) -> ! {
    let (mut sender, mut receiver) = bus;
    loop {
        while receiver.take().is_some() {}
        sender.serve();
        look();
        Timer::after_millis(1).await;
    }
}

/// One look at the controller.
fn look() {
    join();
    CAN1.msr().write(|w| w.set_erri(true));
    CAN1.ier().write_value(interrupts(true));
    interrupt::CAN1_TX.pend();
    interrupt::CAN1_RX0.pend();
}

/// Once the controller is in its initialisation: sets the bit timing and leaves it.
fn join() {
    if CAN1.mcr().read().inrq() && CAN1.msr().read().inak() {
        CAN1.btr().write_value(Btr(BIT_TIMING.register()));
        CAN1.mcr().modify(|w| w.set_inrq(false));
    }
}

/// A handler's own end of a queue, taken over at its first run.
fn own<'a, T>(end: &'a mut Option<T>, from: &Mutex<Cell<Option<T>>>) -> Option<&'a mut T> {
    if end.is_none() {
        *end = critical_section::with(|cs| from.borrow(cs).take());
    }
    end.as_mut()
}

#[handler]
fn CAN1_TX() {
    static mut MAILBOXES: Mailboxes = Mailboxes::new();
    static mut QUEUE: Option<Consumer<'static, Timed>> = None;
    let now = Instant::now().as_micros();
    RAN.fetch_or(RAN_TX, Ordering::Relaxed);
    acknowledge(MAILBOXES, now);
    for mailbox in MAILBOXES.stale(now, STALE) {
        // One that is on the wire just now may still succeed; what became of it is told later.
        CAN1.tsr().write(|w| w.set_abrq(mailbox, true));
    }
    if let Some(queue) = own(QUEUE, &TO_SEND) {
        fill(MAILBOXES, queue, now);
    }
}

/// Takes note of what was sent or given up.
fn acknowledge(mailboxes: &mut Mailboxes, now: Micros) {
    let status = CAN1.tsr().read();
    for mailbox in (0..COUNT).filter(|&mailbox| status.rqcp(mailbox)) {
        // Clears the mailbox's other flags too.
        CAN1.tsr().write(|w| w.set_rqcp(mailbox, true));
        match mailboxes.release(mailbox) {
            Some(frame) if status.txok(mailbox) => {
                WAS_OFF.store(false, Ordering::Relaxed);
                if frame.id == id::TIME_SYNC {
                    critical_section::with(|cs| SYNC_SENT.borrow(cs).set(Some(now)));
                }
            }
            Some(_) => count(|counters| &mut counters.dropped),
            None => {}
        }
    }
}

/// Moves frames from the queue to mailboxes.
fn fill(mailboxes: &mut Mailboxes, queue: &mut Consumer<Timed>, now: Micros) {
    let joined = is_joined();
    while let Some(&(since, frame)) = queue.peek() {
        if now.saturating_sub(since) > STALE {
            count(|counters| &mut counters.dropped);
        } else if joined && let Some(mailbox) = mailboxes.choose(frame.id) {
            mailboxes.fill(
                mailbox,
                Waiting {
                    id: frame.id,
                    since,
                },
            );
            request(mailbox, &frame);
        } else {
            break;
        }
        queue.dequeue();
    }
}

/// Writes a frame into a mailbox and asks for it to be sent.
fn request(mailbox: usize, frame: &bus::CanFrame) {
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

#[handler]
fn CAN1_RX0() {
    static mut QUEUE: Option<Producer<'static, Timed>> = None;
    let Some(queue) = own(QUEUE, &TO_TAKE) else {
        return;
    };
    RAN.fetch_or(RAN_RX0, Ordering::Relaxed);
    let fifo = CAN1.rfr(0);
    for _ in 0..FIFO_LOOKS {
        let state = fifo.read();
        // Each write names one flag: those that are written as read would be cleared.
        if state.fovr() {
            fifo.write(|w| w.set_fovr(true));
            count(|counters| &mut counters.overrun);
        }
        if state.rfom() {
            continue;
        }
        if state.fmp() == 0 {
            break;
        }
        let local = Instant::now().as_micros();
        let frame = first_in_fifo();
        fifo.write(|w| w.set_rfom(true));
        match frame.map(|frame| queue.enqueue((local, frame))) {
            Some(Ok(())) => {}
            Some(Err(_)) => count(|counters| &mut counters.dropped),
            None => count(|counters| &mut counters.unknown),
        }
    }
}

/// The frame at the head of the FIFO; `None` if it is not a data frame of 11 bits.
fn first_in_fifo() -> Option<bus::CanFrame> {
    let registers = CAN1.rx(0);
    let head = registers.rir().read();
    if head.ide() != Ide::STANDARD || head.rtr() != Rtr::DATA {
        return None;
    }
    // Lengths of nine and more stand for eight.
    let length = registers.rdtr().read().dlc().min(8);
    let low = registers.rdlr().read().0;
    let high = registers.rdhr().read().0;
    let mut data = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
    for byte in data.iter_mut().skip(length.into()) {
        *byte = 0;
    }
    Some(bus::CanFrame {
        id: head.stid(),
        length,
        data,
    })
}

/// Counted once, then silent until the next look.
#[handler]
fn CAN1_SCE() {
    CAN1.ier().write_value(interrupts(false));
    count(|counters| &mut counters.errors);
}
