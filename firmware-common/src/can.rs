//! The bus on CAN1: RX on PB8, TX on PB9, 1 Mbit/s.
//!
//! What a board wants to send goes through [`Sender`], what arrived comes out of [`Receiver`], each
//! with one end in the board's tick. Two tasks stand between these queues and the controller; they
//! belong to an executor below the tick's. The controller leaves bus-off by itself.

use core::cell::Cell;

use core_algos::bus::layout::{BIT_RATE, id};
use core_algos::bus::{self, Message};
use core_algos::node::{EPOCH, Micros};
use critical_section::Mutex;
use embassy_stm32::can::filter::Mask32;
use embassy_stm32::can::{
    Can, CanRx, CanTx, Fifo, Frame, Id, Mailbox, Rx0InterruptHandler, Rx1InterruptHandler,
    SceInterruptHandler, TxInterruptHandler,
};
use embassy_stm32::interrupt::typelevel;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac;
use embassy_stm32::peripherals::{CAN1, PB8, PB9};
use embassy_stm32::{Peri, bind_interrupts};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::StaticCell;

use crate::attendance::Badge;

bind_interrupts!(struct Irqs {
    CAN1_RX0 => Rx0InterruptHandler<CAN1>;
    CAN1_RX1 => Rx1InterruptHandler<CAN1>;
    CAN1_SCE => SceInterruptHandler<CAN1>;
    CAN1_TX => SyncStamp, TxInterruptHandler<CAN1>;
});

/// Messages that wait to be sent; an epoch has at most fourteen of one board.
const SENDING: usize = 24;
/// Messages that wait for the next tick; a millisecond has room for nine on the bus.
const ARRIVED: usize = 32;

/// Longest wait of a task before it reports that it goes on.
const REPORT: Duration = Duration::from_millis(50);
/// Time within which the two tasks report at least, µs: a wait, and a bus that is stuck.
pub const REPORTS_WITHIN: Micros = 200_000;

/// Age at which a message is not worth sending any more: two epochs.
const STALE: Duration = Duration::from_micros(2 * EPOCH);

/// What became of the bus since the start, saturating.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, defmt::Format)]
pub struct Counters {
    /// Messages that could not be encoded.
    pub refused: u16,
    /// Messages that found no room in a queue.
    pub dropped: u16,
    /// Frames that are no message of this bus.
    pub unknown: u16,
    /// Errors the controller reported, bus-off among them.
    pub errors: u16,
}

static COUNTERS: Mutex<Cell<Counters>> = Mutex::new(Cell::new(Counters {
    refused: 0,
    dropped: 0,
    unknown: 0,
    errors: 0,
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

/// Whether the controller is off the bus at present.
pub fn is_off() -> bool {
    pac::CAN1.esr().read().boff()
}

/// A message and the local time at which its frame ended.
#[derive(Clone, Copy, Debug)]
pub struct Arrived {
    /// Local time, µs.
    pub local: Micros,
    /// The message.
    pub message: Message,
}

static TO_SEND: Channel<CriticalSectionRawMutex, (Instant, bus::Frame), SENDING> = Channel::new();
static TO_TAKE: Channel<CriticalSectionRawMutex, Arrived, ARRIVED> = Channel::new();
static SYNC_SENT: Mutex<Cell<Option<Micros>>> = Mutex::new(Cell::new(None));

/// The board's end for what it sends.
pub struct Sender(());

impl Sender {
    /// Puts a message in the queue. What cannot be encoded or finds no room is counted. Gives the
    /// message as the other boards will read it.
    pub fn send(&mut self, message: &Message) -> Option<Message> {
        let Ok(frame) = bus::encode(message) else {
            count(|counters| &mut counters.refused);
            return None;
        };
        if TO_SEND.try_send((Instant::now(), frame)).is_err() {
            count(|counters| &mut counters.dropped);
        }
        bus::decode(&frame).ok()
    }

    /// When the latest [`Message::TimeSync`] of this board had left the bus, local time.
    pub fn take_sync_sent(&mut self) -> Option<Micros> {
        critical_section::with(|cs| SYNC_SENT.borrow(cs).take())
    }
}

/// The board's end for what arrived.
pub struct Receiver(());

impl Receiver {
    /// The next message, if there is one.
    pub fn take(&mut self) -> Option<Arrived> {
        TO_TAKE.try_receive().ok()
    }
}

/// Records when a [`Message::TimeSync`] has left; runs before the driver's own handler, which
/// clears the flags.
struct SyncStamp;

impl typelevel::Handler<typelevel::CAN1_TX> for SyncStamp {
    unsafe fn on_interrupt() {
        let status = pac::CAN1.tsr().read();
        let sent = (0..3).any(|mailbox| {
            status.rqcp(mailbox)
                && status.txok(mailbox)
                && pac::CAN1.tx(mailbox).tir().read().stid() == id::TIME_SYNC
        });
        if sent {
            let now = Instant::now().as_micros();
            critical_section::with(|cs| SYNC_SENT.borrow(cs).set(Some(now)));
        }
    }
}

/// Starts the controller and gives the board's two ends and the halves for the two tasks.
pub async fn start(
    can: Peri<'static, CAN1>,
    rx: Peri<'static, PB8>,
    tx: Peri<'static, PB9>,
) -> (Sender, Receiver, CanTx<'static>, CanRx<'static>) {
    static CONTROLLER: StaticCell<Can<'static>> = StaticCell::new();
    let controller = CONTROLLER.init(Can::new(can, rx, tx, Irqs));
    controller
        .modify_filters()
        .enable_bank(0, Fifo::Fifo0, Mask32::accept_all());
    controller.modify_config().set_bitrate(BIT_RATE);
    // Above the tick: the handlers take a few microseconds, and the times they record are what the
    // boards' clocks are compared by.
    for interrupt in [
        interrupt::CAN1_TX,
        interrupt::CAN1_RX0,
        interrupt::CAN1_RX1,
        interrupt::CAN1_SCE,
    ] {
        interrupt.set_priority(Priority::P3);
    }
    controller.enable().await;
    let (tx, rx) = controller.split();
    (Sender(()), Receiver(()), tx, rx)
}

/// Sends what is queued. What is older than 20 ms is dropped, in the queue and in the
/// controller: on a bus that comes back, an old message must not pass for a new one.
#[embassy_executor::task]
pub async fn send(mut can: CanTx<'static>, mut badge: Badge) -> ! {
    loop {
        badge.report();
        let Ok((queued, frame)) = with_timeout(REPORT, TO_SEND.receive()).await else {
            continue;
        };
        if queued.elapsed() > STALE {
            count(|counters| &mut counters.dropped);
            continue;
        }
        let data = frame.data.get(..usize::from(frame.length)).unwrap_or(&[]);
        let Ok(mut next) = Frame::new_standard(frame.id, data) else {
            count(|counters| &mut counters.refused);
            continue;
        };
        loop {
            match with_timeout(STALE, can.write(&next)).await {
                // A frame of lower priority had to give up its mailbox; it goes next.
                Ok(status) => match status.dequeued_frame() {
                    Some(displaced) => next = *displaced,
                    None => break,
                },
                // No mailbox became free: the bus is stuck.
                Err(_) => {
                    for mailbox in [Mailbox::Mailbox0, Mailbox::Mailbox1, Mailbox::Mailbox2] {
                        can.abort(mailbox);
                    }
                    count(|counters| &mut counters.dropped);
                    break;
                }
            }
        }
    }
}

/// Takes in what arrives.
#[embassy_executor::task]
pub async fn receive(mut can: CanRx<'static>, mut badge: Badge) -> ! {
    loop {
        badge.report();
        let Ok(read) = with_timeout(REPORT, can.read()).await else {
            continue;
        };
        let envelope = match read {
            Ok(envelope) => envelope,
            Err(_) => {
                count(|counters| &mut counters.errors);
                // The error stands until the controller has recovered: give it time.
                embassy_time::Timer::after_millis(1).await;
                continue;
            }
        };
        match message(&envelope.frame) {
            Some(message) => {
                let local = envelope.ts.as_micros();
                if TO_TAKE.try_send(Arrived { local, message }).is_err() {
                    count(|counters| &mut counters.dropped);
                }
            }
            None => count(|counters| &mut counters.unknown),
        }
    }
}

fn message(frame: &Frame) -> Option<Message> {
    let Id::Standard(id) = frame.id() else {
        return None;
    };
    if frame.header().rtr() {
        return None;
    }
    let bytes = frame.data();
    let mut data = [0; 8];
    data.get_mut(..bytes.len())?.copy_from_slice(bytes);
    let frame = bus::Frame {
        id: id.as_raw(),
        length: bytes.len() as u8,
        data,
    };
    bus::decode(&frame).ok()
}
