//! Driver of the CAN controller: sending and receiving by the tick, interrupts, supervision.
//!
//! - **Start**: the driver requests initialisation mode, the only mode in which the bit timing can be written, and then
//!   leaves it. The controller joins the bus after eleven recessive bits. No code waits for the bus: while it is held
//!   dominant, the board runs, [`is_off`] is true, and the controller joins once the bus is free.
//! - **Sending**: `CAN1_TX` moves frames from the queue to free mailboxes, records when a `TimeSync` has left, and
//!   drops frames that are too old ([`queues`](super::queues)). The controller repeats a frame until
//!   a node acknowledges it.
//! - **Receiving**: `CAN1_RX0` empties the FIFO of three frames and timestamps each frame.
//! - **Errors**: `CAN1_SCE` counts the first error between two checks of [`supervise`]; on a bus without an
//!   acknowledging node an error occurs every 0.1 ms. The controller leaves bus-off by itself after 128 times
//!   eleven recessive bits.

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use core_algos::bus::layout::id;
use core_algos::bus::{self, Message};
use core_algos::time::Micros;
use critical_section::Mutex;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::peripherals::{self, PB8, PB9};
use embassy_stm32::{Peri, interrupt as handler};
use embassy_time::{Duration, Instant, Timer};
use heapless::spsc::{Consumer, Producer};
use static_cell::ConstStaticCell;

use super::Arrived;
use super::health::{Counters, Health};
use super::queues::{Ends, Queues, Timed, Transmitter};
use super::registers::{self, Fifo};
use super::service::{self, ServicePort};
use crate::record::Recorder;
use crate::task_watchdog::CheckIn;

/// Period of the checks of the controller.
const CHECK: Duration = Duration::from_millis(5);
/// Longest time between two reports of the bus task, µs.
pub const REPORTS_WITHIN: Micros = 200_000;
/// Polls of the FIFO in one interrupt; a frame takes at least 47 µs, so fewer polls empty the FIFO.
const FIFO_POLLS: u32 = 16;

static HEALTH: Health = Health::new();
/// The handlers' ends of both queues; each handler takes its end at its first run.
static TRANSMITTER: Mutex<Cell<Option<Transmitter<'static>>>> = Mutex::new(Cell::new(None));
static FROM_BUS: Mutex<Cell<Option<Producer<'static, Timed>>>> = Mutex::new(Cell::new(None));
static SYNC_SENT: Mutex<Cell<Option<Micros>>> = Mutex::new(Cell::new(None));
/// Bits of the handlers that ran since the last check.
static RAN: AtomicU32 = AtomicU32::new(0);
const RAN_TX: u32 = 1 << 0;
const RAN_RX0: u32 = 1 << 1;

/// Counters of the bus since the start.
pub fn counters() -> Counters {
    HEALTH.counters()
}

/// True if the board cannot send: not yet on the bus, bus-off after too many errors, or no frame acknowledged since
/// bus-off.
pub fn is_off() -> bool {
    let was_off = HEALTH.was_off(registers::is_bus_off());
    !registers::is_joined() || was_off
}

/// Access to the bus, one end per user.
pub struct Bus {
    /// The tick's end for sending.
    pub sender: Sender,
    /// The tick's end for receiving.
    pub receiver: Receiver,
    /// The link's end, for frames of the link.
    pub service: ServicePort,
}

/// The tick's end for sending messages on the bus.
pub struct Sender {
    queue: Producer<'static, Timed>,
    service: service::Outgoing,
    recorder: Recorder,
}

impl Sender {
    /// Queues a message and returns it as other boards decode it; `None` if it cannot be encoded. A message for which
    /// the queue has no room is counted as dropped.
    pub fn send(&mut self, message: &Message) -> Option<Message> {
        let Ok(frame) = bus::encode(message) else {
            HEALTH.count(|counters| &mut counters.refused);
            return None;
        };
        self.recorder.put_frame(&frame);
        self.put(frame);
        bus::decode(&frame).ok()
    }

    /// Sends the next frame of the link; call it once per tick.
    pub fn send_link_frame(&mut self) {
        if let Some(frame) = self.service.next() {
            self.put(frame);
        }
    }

    fn put(&mut self, frame: bus::CanFrame) {
        let now = Instant::now().as_micros();
        if self.queue.enqueue((now, frame)).is_err() {
            HEALTH.count(|counters| &mut counters.dropped);
        }
        // If all mailboxes are full, the next free mailbox raises the interrupt.
        if registers::has_free_mailbox() {
            interrupt::CAN1_TX.pend();
        }
    }

    /// Local time at which this board's latest [`Message::TimeSync`] had left the bus, µs; `None` if none has left
    /// since the last call.
    pub fn take_sync_sent(&mut self) -> Option<Micros> {
        critical_section::with(|cs| SYNC_SENT.borrow(cs).take())
    }
}

/// The tick's end for receiving messages from the bus.
pub struct Receiver {
    queue: Consumer<'static, Timed>,
    service: service::Incoming,
    recorder: Recorder,
}

impl Receiver {
    /// The next message; `None` if none waits. Frames of the link go to the link; undecodable frames are counted.
    pub fn take(&mut self) -> Option<Arrived> {
        loop {
            let (local, frame) = self.queue.dequeue()?;
            if self.service.take(&frame) {
                continue;
            }
            self.recorder.put_frame(&frame);
            match bus::decode(&frame) {
                Ok(message) => return Some(Arrived { local, message }),
                Err(_) => HEALTH.count(|counters| &mut counters.unknown),
            }
        }
    }
}

/// Starts the controller; call it once. The controller joins the bus under [`supervise`]. `recorder` records the
/// tick's frames.
pub fn start(
    can: Peri<'static, peripherals::CAN1>,
    rx: Peri<'static, PB8>,
    tx: Peri<'static, PB9>,
    recorder: &Recorder,
) -> Bus {
    static QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues::new());
    let Ends {
        to_send,
        arrived,
        transmitter,
        from_bus,
    } = QUEUES.take().split();
    critical_section::with(|cs| {
        TRANSMITTER.borrow(cs).set(Some(transmitter));
        FROM_BUS.borrow(cs).set(Some(from_bus));
    });
    registers::start(can, rx, tx);
    // These interrupts preempt the tick: their handlers take only a few microseconds, and a delayed timestamp would
    // make the boards' common time wrong.
    for interrupt in [interrupt::CAN1_TX, interrupt::CAN1_RX0, interrupt::CAN1_SCE] {
        interrupt.set_priority(Priority::P3);
        // SAFETY: the handlers' data are set before the interrupts are enabled.
        unsafe { interrupt.enable() };
    }
    let (incoming, outgoing, service) = service::split();
    Bus {
        sender: Sender {
            queue: to_send,
            service: outgoing,
            recorder: recorder.clone(),
        },
        receiver: Receiver {
            queue: arrived,
            service: incoming,
            recorder: recorder.clone(),
        },
        service,
    }
}

/// Supervises what raises no interrupt: joining the bus and frames that wait too long. Every check also enables the
/// error interrupt again and triggers both handlers. The task reports to the watchdog only if both handlers ran.
#[embassy_executor::task]
pub async fn supervise(mut check_in: CheckIn) -> ! {
    loop {
        if RAN.swap(0, Ordering::Relaxed) == RAN_TX | RAN_RX0 {
            check_in.report();
        }
        check();
        Timer::after(CHECK).await;
    }
}

/// Runs the bus of a board in a session: only frames of the link pass, because the nodes take no part in the bus.
#[embassy_executor::task]
pub async fn run_session_bus(mut sender: Sender, mut receiver: Receiver) -> ! {
    loop {
        while receiver.take().is_some() {}
        sender.send_link_frame();
        check();
        Timer::after_millis(1).await;
    }
}

fn check() {
    registers::join();
    registers::clear_error();
    registers::enable_interrupts(true);
    interrupt::CAN1_TX.pend();
    interrupt::CAN1_RX0.pend();
}

/// A handler's end of a queue, taken at the handler's first run.
fn own<'a, T>(end: &'a mut Option<T>, from: &Mutex<Cell<Option<T>>>) -> Option<&'a mut T> {
    if end.is_none() {
        *end = critical_section::with(|cs| from.borrow(cs).take());
    }
    end.as_mut()
}

#[handler]
fn CAN1_TX() {
    static mut OWN: Option<Transmitter<'static>> = None;
    let now = Instant::now().as_micros();
    let Some(transmitter) = own(OWN, &TRANSMITTER) else {
        return;
    };
    RAN.fetch_or(RAN_TX, Ordering::Relaxed);
    acknowledge(transmitter, now);
    transmitter.stale(now).for_each(registers::abort);
    let drop = || HEALTH.count(|counters| &mut counters.dropped);
    transmitter.fill(now, registers::is_joined(), registers::request, drop);
}

/// Handles mailboxes whose frame was sent or aborted.
fn acknowledge(transmitter: &mut Transmitter, now: Micros) {
    for (mailbox, sent) in registers::take_finished() {
        match transmitter.release(mailbox) {
            Some(frame) if sent => {
                HEALTH.on_acknowledged();
                if frame.id == id::TIME_SYNC {
                    critical_section::with(|cs| SYNC_SENT.borrow(cs).set(Some(now)));
                }
            }
            Some(_) => HEALTH.count(|counters| &mut counters.dropped),
            None => {}
        }
    }
}

#[handler]
fn CAN1_RX0() {
    static mut OWN: Option<Producer<'static, Timed>> = None;
    let Some(queue) = own(OWN, &FROM_BUS) else {
        return;
    };
    RAN.fetch_or(RAN_RX0, Ordering::Relaxed);
    for _ in 0..FIFO_POLLS {
        let (fifo, overrun) = registers::fifo();
        if overrun {
            HEALTH.count(|counters| &mut counters.overrun);
        }
        match fifo {
            Fifo::Releasing => continue,
            Fifo::Empty => break,
            Fifo::Frame => {}
        }
        let local = Instant::now().as_micros();
        let frame = registers::take_frame();
        match frame.map(|frame| queue.enqueue((local, frame))) {
            Some(Ok(())) => {}
            Some(Err(_)) => HEALTH.count(|counters| &mut counters.dropped),
            None => HEALTH.count(|counters| &mut counters.unknown),
        }
    }
}

/// Counts one error, then disables the error interrupt until the next check.
#[handler]
fn CAN1_SCE() {
    registers::enable_interrupts(false);
    HEALTH.count(|counters| &mut counters.errors);
}
