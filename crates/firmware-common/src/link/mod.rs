//! The link of a board: its serial port, and what it serves there.
//!
//! A board that drives says who it is ([`Link::attend`]). With its motors off it can be asked for a session with a rig: it
//! resets, and its nodes are fed from the link instead of sensors and bus ([`Link::serve`]). Drivers, sensors and bus are
//! not started then; the session ends with a reset.

pub mod uart;

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, Ordering};

use core_algos::control::path::PathError;
use core_algos::link::attendant::{REPORT_FRAMES, REPORT_MS};
use core_algos::link::protocol::{Packed, StackUse, Telemetry};
use core_algos::link::{Attendant, Demand, Endpoint, Identity, Order};
use core_algos::node::board::{Board, Ready};
use core_algos::node::lead::{LeadNode, Output};
use core_algos::topology::Role;
use embassy_executor::Spawner;
use embassy_stm32::Peri;
use embassy_stm32::peripherals::{PB10, PB11, USART3};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::StaticCell;

use crate::store::chip::Parameters;
use crate::watchdog::Watchdog;
use crate::{can, fault, stack};
use uart::Uart;

/// Longest wait for bytes before the watchdog is fed all the same.
const IDLE: Duration = Duration::from_millis(100);
/// A session in which nothing was said for so long has ended.
const SILENCE: Duration = Duration::from_secs(60);
/// Time between reports in the log.
const REPORT: Duration = Duration::from_secs(10);

/// Word that asks the next start for a session; chance after power came on.
#[unsafe(link_section = ".uninit.SESSION")]
static mut WANTED: MaybeUninit<u32> = MaybeUninit::uninit();
const SESSION: u32 = 0x5e55_10e1;

/// True while the motors of this board may be on.
static ARMED: AtomicBool = AtomicBool::new(false);

/// Order on its way to the tick, and how it was carried out.
static ORDER: Signal<CriticalSectionRawMutex, Order> = Signal::new();
static DONE: Signal<CriticalSectionRawMutex, Result<(), PathError>> = Signal::new();

/// Output of the lead node on its way to a host that watches.
static LEAD: Signal<CriticalSectionRawMutex, Telemetry> = Signal::new();

/// Hands over the output of a step of the lead node, if a host watches.
pub fn tell(output: Output, lead: &mut LeadNode) {
    if can::tap::is_watched() {
        LEAD.signal(Telemetry::of(output, lead));
    }
}

/// Carries out an order that has come, if one has.
pub fn carry_out(lead: &mut LeadNode) {
    if let Some(order) = ORDER.try_take() {
        DONE.signal(order.carry_out(lead));
    }
}

/// Says whether the motors of this board may be on.
pub fn set_armed(armed: bool) {
    ARMED.store(armed, Ordering::Relaxed);
}

/// True if this start was asked for by a request for a session; once.
pub fn session_wanted() -> bool {
    let place = addr_of_mut!(WANTED).cast::<u32>();
    // SAFETY: nobody else uses the word, and any pattern is a number; volatile, because it was written before the
    // reset.
    unsafe {
        let wanted = place.read_volatile() == SESSION;
        place.write_volatile(0);
        wanted
    }
}

/// Resets the board, into a session or out of it.
fn restart(session: bool) -> ! {
    let word = if session { SESSION } else { 0 };
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

    /// Answers as a board that drives.
    pub fn attend(self, spawner: Spawner) {
        spawner.spawn(attend(self).expect("spawned once"));
    }

    /// Serves a session.
    pub fn serve(self, watchdog: Watchdog, parameters: &'static mut Parameters, spawner: Spawner) {
        spawner.spawn(serve(self, watchdog, parameters).expect("spawned once"));
    }

    /// The place of the nodes of a board that drives: that of the nodes in a session.
    pub fn place(&self, nodes: Ready) -> &'static mut Board {
        endpoint(self.identity).begin(nodes)
    }
}

/// Answers what the link brings to a board that drives, for ever.
#[embassy_executor::task]
async fn attend(link: Link) -> ! {
    static ATTENDANT: StaticCell<Attendant> = StaticCell::new();
    let Link { mut uart, identity } = link;
    let attendant = ATTENDANT.init_with(|| Attendant::new(identity, stack_use));
    let mut buffer = [0; 64];
    loop {
        let count = match can::tap::is_watched() {
            true => {
                let read = uart.read(&mut buffer);
                let count = with_timeout(Duration::from_millis(REPORT_MS), read).await;
                report_to_host(attendant, &mut uart);
                count.unwrap_or(0)
            }
            false => uart.read(&mut buffer).await,
        };
        let armed = ARMED.load(Ordering::Relaxed);
        match attendant.receive(&buffer[..count], armed, &mut |reply| uart.write(reply)) {
            Some(Demand::Order(order)) => {
                ORDER.signal(order);
                let done = DONE.wait().await;
                attendant.done(done, &mut |reply| uart.write(reply));
            }
            Some(Demand::Watch) => can::tap::watch(),
            Some(Demand::Session) => {
                uart.flush();
                defmt::info!("reset into a session with a rig");
                restart(true);
            }
            None => {}
        }
    }
}

/// Sends the host the frames of the bus and the next part of the lead node's output. While the report before is on the
/// line there is no other: frames wait, and an output is replaced by the next.
fn report_to_host(attendant: &mut Attendant, uart: &mut Uart) {
    if !uart.is_free() {
        return;
    }
    if attendant.wants_telemetry()
        && let Some(telemetry) = LEAD.try_take()
    {
        attendant.tell(&telemetry);
    }
    let mut bus = Packed::new();
    for frame in core::iter::from_fn(can::tap::take).take(REPORT_FRAMES) {
        // There is room for this many.
        let _ = bus.push(&frame);
    }
    attendant.report(can::tap::lost(), &bus, &mut |report| uart.write(report));
}

/// Serves a session until the host leaves or is silent. The watchdog is fed once a turn: a node that does not return
/// from a step lets it reset the board.
#[embassy_executor::task]
async fn serve(link: Link, mut watchdog: Watchdog, parameters: &'static mut Parameters) -> ! {
    let Link { mut uart, identity } = link;
    watchdog.shorten();
    let endpoint = endpoint(identity);
    endpoint.load(parameters.contents());
    defmt::info!("{}: session with a rig", identity.role.name());
    let mut buffer = [0; 256];
    let (mut heard, mut reported) = (Instant::now(), Instant::now());
    loop {
        watchdog.feed();
        if let Ok(count) = with_timeout(IDLE, uart.read(&mut buffer)).await {
            endpoint.receive(&buffer[..count], &mut |reply| uart.write(reply));
            if let Some(save) = endpoint.save() {
                watchdog.lengthen();
                let values = parameters.write(&save.settings, save.off);
                watchdog.shorten();
                let done = values.map(|values| (values, parameters.contents()));
                endpoint.saved(done, &mut |reply| uart.write(reply));
            }
            heard = Instant::now();
        }
        if endpoint.has_left() || heard.elapsed() > SILENCE {
            uart.flush();
            defmt::info!("end of the session");
            restart(false);
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
