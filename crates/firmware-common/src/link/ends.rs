//! Channels between the tick and the link of a board that drives.
//!
//! | from → to | what |
//! |---|---|
//! | link → tick | an order with its number; lapse of the lease; request to restart the nodes |
//! | tick → link | result of an order; output of the lead node; log entries; state of the motors |

use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use core_algos::control::path::PathError;
use core_algos::link::protocol::Telemetry;
use core_algos::link::record::Entry;
use core_algos::link::{MotorState, Order};
use core_algos::node::lead::{LeadNode, Output};
use core_algos::time::Micros;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;

use crate::record::{Entries, Reader, Recorder, Ring};

/// Result of an order; an error if the lead node rejected a part.
pub type OrderResult = Result<(), PathError>;

/// Memory of the channels: one per board, in a static.
pub struct Channels {
    shared: Shared,
    ring: Ring,
}

struct Shared {
    motors: AtomicU8,
    begin: AtomicBool,
    lapsed: AtomicBool,
    order: Signal<CriticalSectionRawMutex, (u16, Order)>,
    result: Signal<CriticalSectionRawMutex, OrderResult>,
    telemetry: Signal<CriticalSectionRawMutex, Telemetry>,
}

impl Channels {
    /// No order in progress, motors off, no host that watches.
    pub const fn new() -> Self {
        Self {
            shared: Shared {
                motors: AtomicU8::new(MotorState::Off as u8),
                begin: AtomicBool::new(false),
                lapsed: AtomicBool::new(false),
                order: Signal::new(),
                result: Signal::new(),
                telemetry: Signal::new(),
            },
            ring: Ring::new(),
        }
    }

    /// Splits the channels into the two ends.
    pub fn split(&'static mut self) -> (TickEnd, LinkEnd) {
        let Self { shared, ring } = self;
        let shared = &*shared;
        let (recorder, reader) = ring.split();
        (TickEnd { shared, recorder }, LinkEnd { shared, reader })
    }
}

/// The tick's end of the channels to the link.
pub struct TickEnd {
    shared: &'static Shared,
    recorder: Recorder,
}

impl TickEnd {
    /// Recorder for the frames of the bus.
    pub fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Records an entry, if a host watches.
    pub fn put(&mut self, entry: &Entry) {
        self.recorder.put(entry);
    }

    /// Publishes the output of the lead node's step at `now`, if a host watches.
    pub fn publish(&mut self, now: Micros, output: Output, lead: &mut LeadNode) {
        if self.recorder.is_watched() {
            self.shared
                .telemetry
                .signal(Telemetry::of(now, output, lead));
        }
    }

    /// Executes the order of a host, if one has arrived, and stops the robot if the host's lease lapsed.
    pub fn execute_orders(&mut self, lead: &mut LeadNode) {
        if self.shared.lapsed.swap(false, Ordering::Relaxed) {
            self.execute(Order::Lost, lead);
        }
        if let Some((number, order)) = self.shared.order.try_take() {
            let result = order.execute(lead);
            // A rejected order ends the recording, because the lead node may have accepted some of the order's points.
            self.put(&match result {
                Ok(()) => Entry::Carried(number),
                Err(_) => Entry::End,
            });
            self.shared.result.signal(result);
        }
    }

    /// Executes an order that the board itself gives.
    pub fn execute(&mut self, order: Order, lead: &mut LeadNode) {
        // The board's own orders are finite and hold no points, so they cannot fail.
        let _ = order.execute(lead);
        self.put(&Entry::Order(order));
    }

    /// Sets the state of the motors.
    pub fn set_motors(&mut self, motors: MotorState) {
        self.shared.motors.store(motors as u8, Ordering::Relaxed);
    }

    /// True at the first call after a host has requested a restart of the nodes.
    pub fn take_begin(&mut self) -> bool {
        self.shared.begin.swap(false, Ordering::Relaxed)
    }
}

/// The link's end of the channels to the tick.
pub struct LinkEnd {
    shared: &'static Shared,
    reader: Reader,
}

impl LinkEnd {
    /// State of the motors, as the tick last set it.
    pub fn motors(&self) -> MotorState {
        let state = self.shared.motors.load(Ordering::Relaxed);
        [MotorState::Off, MotorState::Braking]
            .into_iter()
            .find(|motors| *motors as u8 == state)
            .unwrap_or(MotorState::Driven)
    }

    /// Sends the tick an order with this number.
    pub fn order(&mut self, number: u16, order: Order) {
        self.shared.order.signal((number, order));
    }

    /// Waits for the result of an order.
    pub async fn result(&self) -> OrderResult {
        self.shared.result.wait().await
    }

    /// Reports to the tick that the host's lease lapsed.
    pub fn on_lease_lapsed(&mut self) {
        self.shared.lapsed.store(true, Ordering::Relaxed);
    }

    /// Asks the tick to restart the nodes.
    pub fn begin(&mut self) {
        self.shared.begin.store(true, Ordering::Relaxed);
    }

    /// Starts recording for a host that watches.
    pub fn watch(&mut self) {
        self.reader.watch();
    }

    /// True once a host watches.
    pub fn is_watched(&self) -> bool {
        self.reader.is_watched()
    }

    /// Takes the latest output of the lead node; `None` until a new output is published.
    pub fn take_telemetry(&mut self) -> Option<Telemetry> {
        self.shared.telemetry.try_take()
    }

    /// Takes the oldest entries that fit into `max_bytes` bytes.
    pub fn take_entries(&mut self, max_bytes: usize) -> Entries {
        self.reader.take(max_bytes)
    }

    /// True if the next entry did not fit into the last report.
    pub fn is_behind(&self) -> bool {
        self.reader.is_behind()
    }

    /// Log entries lost because the ring was full, modulo 65 536.
    pub fn lost(&self) -> u16 {
        self.reader.lost()
    }
}
