//! The link of a board: its serial port, and what it serves there.
//!
//! A board that drives says who it is ([`Link::attend`]). With its motors off it can be asked for a session: it resets, and
//! its nodes are fed from the link instead of sensors and bus ([`Link::serve`]). Drivers and sensors are not started then;
//! the session ends with a reset.
//!
//! A host at the serial port of another board reaches this one over the bus. A session that it asks for there is served
//! there.

pub mod uart;

use core::future::pending;
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, Ordering};

use core_algos::control::path::PathError;
use core_algos::link::attendant::{REPORT_MS, Station};
use core_algos::link::framing::Decoder;
use core_algos::link::protocol::{StackUse, Telemetry};
use core_algos::link::record::Entry;
use core_algos::link::segment::{self, Direction};
use core_algos::link::{Attendant, Demand, Endpoint, Identity, Order};
use core_algos::node::board::{Board, Ready};
use core_algos::node::lead::{LeadNode, Output};
use core_algos::node::robot::RobotConfig;
use core_algos::time::Micros;
use core_algos::topology::Role;
use embassy_executor::Spawner;
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_stm32::Peri;
use embassy_stm32::peripherals::{PB10, PB11, USART3};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use static_cell::StaticCell;

use crate::can::{self, service};
use crate::record;
use crate::store::chip::Parameters;
use crate::watchdog::Watchdog;
use crate::{fault, stack};
use uart::Uart;

/// Longest wait for bytes before the watchdog is fed all the same.
const IDLE: Duration = Duration::from_millis(100);
/// Time between reports to a host that watches.
const REPORT_EVERY: Duration = Duration::from_millis(REPORT_MS);
/// A session in which nothing was said for so long has ended.
const SILENCE: Duration = Duration::from_secs(60);
/// Time between reports in the log.
const REPORT: Duration = Duration::from_secs(10);

/// Word that asks the next start for a session; chance after power came on.
#[unsafe(link_section = ".uninit.SESSION")]
static mut WANTED: MaybeUninit<u32> = MaybeUninit::uninit();

/// Way from the host to the board, with the word that asks for a session there.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(u32)]
pub enum Way {
    /// The board's serial port.
    Serial = 0x5e55_10e1,
    /// The port of another board, and the bus.
    Bus = 0x5e55_10e2,
}

impl Way {
    /// Sends bytes of this board to the host.
    fn send(self, uart: &mut Uart, role: Role, bytes: &[u8]) {
        match self {
            Self::Serial => uart.write(bytes),
            Self::Bus => service::send(segment::frames(role, Direction::From, bytes)),
        }
    }

    /// Waits until all is sent.
    async fn flush(self, uart: &mut Uart) {
        if self == Self::Serial {
            return uart.flush();
        }
        while !service::is_sent() {
            Timer::after_millis(1).await;
        }
        // Longer than a frame waits for a busy bus.
        Timer::after_millis(20).await;
    }
}

/// True while the motors of this board may be on.
static ARMED: AtomicBool = AtomicBool::new(false);

/// Number and order of a host on their way to the tick, and how it was carried out.
static ORDER: Signal<CriticalSectionRawMutex, (u16, Order)> = Signal::new();
/// The lease of a host lapsed.
static LAPSED: AtomicBool = AtomicBool::new(false);
static DONE: Signal<CriticalSectionRawMutex, Result<(), PathError>> = Signal::new();

/// Output of the lead node on its way to a host that watches.
static LEAD: Signal<CriticalSectionRawMutex, Telemetry> = Signal::new();

/// Hands over the output of a step of the lead node at `now`, if a host watches.
pub fn tell(now: Micros, output: Output, lead: &mut LeadNode) {
    if record::is_watched() {
        LEAD.signal(Telemetry::of(now, output, lead));
    }
}

/// Carries out an order of a host that has come, if one has.
pub fn carry_out_order(lead: &mut LeadNode) {
    if LAPSED.swap(false, Ordering::Relaxed) {
        carry_out(Order::Lost, lead);
    }
    if let Some((number, order)) = ORDER.try_take() {
        let done = order.carry_out(lead);
        // Of a refused one some points were taken.
        record::put(&match done {
            Ok(()) => Entry::Carried(number),
            Err(_) => Entry::End,
        });
        DONE.signal(done);
    }
}

/// Carries out an order of the board itself.
pub fn carry_out(order: Order, lead: &mut LeadNode) {
    // The board's own are finite and hold no points.
    let _ = order.carry_out(lead);
    record::put(&Entry::Order(order));
}

/// Says whether the motors of this board may be on.
pub fn set_armed(armed: bool) {
    ARMED.store(armed, Ordering::Relaxed);
}

/// Way of the request for a session that has asked for this start, if one has; once.
pub fn session_wanted() -> Option<Way> {
    let place = addr_of_mut!(WANTED).cast::<u32>();
    // SAFETY: nobody else uses the word, and any pattern is a number; volatile, because it was written before the
    // reset.
    unsafe {
        let wanted = place.read_volatile();
        place.write_volatile(0);
        [Way::Serial, Way::Bus]
            .into_iter()
            .find(|way| *way as u32 == wanted)
    }
}

/// Resets the board, into a session or out of it.
fn restart(session: Option<Way>) -> ! {
    let word = session.map_or(0, |way| way as u32);
    // SAFETY: as in [`session_wanted`].
    unsafe { addr_of_mut!(WANTED).cast::<u32>().write_volatile(word) };
    cortex_m::peripheral::SCB::sys_reset()
}

/// The serial port of a board.
pub struct Link {
    uart: Uart,
    identity: Identity,
}

impl Link {
    /// Opens it, once. `build` names the image.
    pub fn open(
        uart: Peri<'static, USART3>,
        rx: Peri<'static, PB11>,
        tx: Peri<'static, PB10>,
        role: Role,
        build: &'static str,
    ) -> Self {
        Self {
            uart: Uart::start(uart, rx, tx),
            identity: Identity { build, role },
        }
    }

    /// Answers as a board that drives, with nodes of this configuration.
    pub fn attend(self, config: &RobotConfig, spawner: Spawner) {
        static CONFIG: StaticCell<RobotConfig> = StaticCell::new();
        let config = CONFIG.init_with(|| *config);
        spawner.spawn(attend(self, config).expect("spawned once"));
    }

    /// Serves a session; `bus` is the bus of one that was asked for there.
    pub fn serve(
        self,
        watchdog: Watchdog,
        parameters: &'static mut Parameters,
        bus: Option<(can::Sender, can::Receiver)>,
        spawner: Spawner,
    ) {
        let way = if bus.is_some() { Way::Bus } else { Way::Serial };
        if let Some(bus) = bus {
            spawner.spawn(can::carry(bus).expect("spawned once"));
        }
        spawner.spawn(serve(self, way, watchdog, parameters).expect("spawned once"));
    }

    /// The place of the nodes of a board that drives: that of the nodes in a session.
    pub fn place(&self, nodes: Ready) -> &'static mut Board {
        endpoint(self.identity).begin(nodes)
    }
}

/// A board that drives, at its link.
struct Attending {
    uart: Uart,
    role: Role,
    /// For the host at the port of this board, and at that of another one.
    at_port: &'static mut Attendant,
    on_bus: &'static mut Attendant,
    station: Station,
    taker: record::Taker,
    /// Replies of other boards.
    relayed: Decoder,
    /// Way of the latest order.
    ordered: Way,
}

/// Answers what the link brings to a board that drives, for ever.
#[embassy_executor::task]
async fn attend(link: Link, config: &'static RobotConfig) -> ! {
    static ATTENDANTS: StaticCell<[Attendant; 2]> = StaticCell::new();
    let Link { uart, identity } = link;
    let attendant = || Attendant::new(identity, config, stack_use, fault::record);
    let [at_port, on_bus] = ATTENDANTS.init_with(|| [(); 2].map(|()| attendant()));
    let mut attending = Attending {
        uart,
        role: identity.role,
        at_port,
        on_bus,
        station: Station::default(),
        taker: record::Taker::default(),
        relayed: Decoder::new(),
        ordered: Way::Serial,
    };
    let mut buffer = [0; 64];
    loop {
        let watched = record::is_watched();
        let wait = if watched { REPORT_EVERY } else { IDLE };
        // With more to report than fits, the next report follows at once.
        let is_behind = attending.taker.is_behind();
        let sent = async {
            match is_behind {
                true => uart::sent().await,
                false => pending().await,
            }
        };
        let arrived = select(attending.uart.read(&mut buffer), service::receive());
        let arrived = with_timeout(wait, select3(arrived, sent, DONE.wait())).await;
        if watched {
            attending.report();
        }
        attending.station.now = Instant::now().as_micros();
        attending.station.armed = ARMED.load(Ordering::Relaxed);
        let now = attending.station.now;
        if attending.station.lease.take_lapsed(now) {
            LAPSED.store(true, Ordering::Relaxed);
        }
        match arrived {
            Ok(Either3::First(Either::First(count))) => {
                let bytes = buffer.get(..count).unwrap_or_default();
                attending.receive(Way::Serial, bytes).await;
            }
            Ok(Either3::First(Either::Second(frame))) => match segment::address(frame.id) {
                Some((to, Direction::To)) if to == attending.role => {
                    attending.receive(Way::Bus, frame.bytes()).await;
                }
                Some((from, Direction::From)) => attending.relay(from, frame.bytes()),
                _ => {}
            },
            Ok(Either3::Third(done)) => attending.done(done),
            Ok(Either3::Second(())) | Err(_) => {}
        }
    }
}

impl Attending {
    /// Takes bytes of a host, and does what they demand.
    async fn receive(&mut self, way: Way, bytes: &[u8]) {
        let attendant = match way {
            Way::Serial => &mut *self.at_port,
            Way::Bus => &mut *self.on_bus,
        };
        let (uart, role) = (&mut self.uart, self.role);
        let mut send = |reply: &[u8]| way.send(uart, role, reply);
        let demand = attendant.receive(bytes, &mut self.station, &mut send);
        match (demand, way) {
            (Some(Demand::Order(number, order)), way) => {
                ORDER.signal((number, order));
                self.ordered = way;
            }
            (Some(Demand::Session), way) => {
                way.flush(&mut self.uart).await;
                defmt::info!("reset into a session");
                restart(Some(way));
            }
            (Some(Demand::Watch), Way::Serial) => record::watch(),
            (Some(Demand::Record), _) => record::begin(),
            (Some(Demand::Send(frame)), _) => service::send(core::iter::once(frame)),
            (Some(Demand::Relay(to, frame)), Way::Serial) => {
                service::send(segment::frames(to, Direction::To, frame.repeated()));
            }
            // A host that watches has a port, and a board relays for its port only.
            (Some(Demand::Watch | Demand::Relay(..)), Way::Bus) | (None, _) => {}
        }
    }

    /// Answers the latest order.
    fn done(&mut self, done: Result<(), PathError>) {
        let (uart, role, way) = (&mut self.uart, self.role, self.ordered);
        let attendant = match way {
            Way::Serial => &mut *self.at_port,
            Way::Bus => &mut *self.on_bus,
        };
        attendant.done(done, &mut |reply| way.send(uart, role, reply));
    }

    /// Takes a part of another board's reply.
    fn relay(&mut self, from: Role, bytes: &[u8]) {
        let uart = &mut self.uart;
        for &byte in bytes {
            if let Some(payload) = self.relayed.take_byte(byte) {
                self.at_port
                    .relayed(from, payload, &mut |reply| uart.write(reply));
            }
        }
    }

    /// Sends the host entries of the tick and the next part of the lead node's output. While the report before is on the
    /// line there is no other: entries wait, and an output is replaced by the next.
    fn report(&mut self) {
        if !self.uart.is_free() {
            return;
        }
        if self.at_port.wants_telemetry()
            && let Some(telemetry) = LEAD.try_take()
        {
            self.at_port.tell(&telemetry);
        }
        let entries = self.taker.take(self.at_port.room());
        let uart = &mut self.uart;
        self.at_port
            .report(record::lost(), &entries, &mut |report| uart.write(report));
    }
}

/// Serves a session until the host leaves or is silent. The watchdog is fed once a turn: a node that does not return
/// from a step lets it reset the board.
#[embassy_executor::task]
async fn serve(link: Link, way: Way, watchdog: Watchdog, parameters: &'static mut Parameters) -> ! {
    let Link { mut uart, identity } = link;
    let role = identity.role;
    let (mut feeder, mut extension) = watchdog.split();
    let endpoint = endpoint(identity);
    endpoint.load(parameters.contents());
    defmt::info!("{}: session", role.name());
    let mut buffer = [0; 256];
    let (mut heard, mut reported) = (Instant::now(), Instant::now());
    loop {
        feeder.feed();
        let arrived = select(uart.read(&mut buffer), service::receive());
        let arrived = with_timeout(IDLE, arrived).await;
        let bytes = match &arrived {
            Ok(Either::First(count)) if way == Way::Serial => &buffer[..*count],
            Ok(Either::Second(frame))
                if segment::address(frame.id) == Some((role, Direction::To)) =>
            {
                frame.bytes()
            }
            _ => &[],
        };
        if !bytes.is_empty() {
            let mut send = |reply: &[u8]| way.send(&mut uart, role, reply);
            endpoint.receive(bytes, &mut send);
            if let Some(save) = endpoint.save() {
                let values = extension.during(|| parameters.write(&save.settings, save.off));
                let done = values.map(|values| (values, parameters.contents()));
                endpoint.saved(done, &mut send);
            }
            heard = Instant::now();
        }
        if endpoint.has_left() || heard.elapsed() > SILENCE {
            way.flush(&mut uart).await;
            defmt::info!("end of the session");
            restart(None);
        }
        if reported.elapsed() > REPORT {
            reported = Instant::now();
            report(endpoint);
        }
    }
}

/// The endpoint in its static place. Not inlined: should it pass over the stack, all 20 kB, nothing else
/// is there.
#[inline(never)]
fn endpoint(identity: Identity) -> &'static mut Endpoint {
    static ENDPOINT: StaticCell<Endpoint> = StaticCell::new();
    ENDPOINT.init_with(|| Endpoint::new(identity, stack_use))
}

/// Stack use for the host and the log.
fn stack_use() -> StackUse {
    let stack = stack::high_water();
    defmt::info!("{}", stack);
    StackUse {
        used_bytes: stack.used as u32,
        budget_bytes: stack.budget as u32,
        size_bytes: stack.size as u32,
    }
}

fn report(endpoint: &Endpoint) {
    let frames = endpoint.counters();
    defmt::info!(
        "frames {} whole, {} damaged; {}; {}",
        frames.received,
        frames.damaged,
        stack::high_water(),
        fault::counts()
    );
}
