//! Hardware in the loop: the board's nodes fed from a serial link instead of sensors and bus.
//!
//! The endpoint in `core-algos` holds the nodes and speaks the protocol; here are the links that
//! carry its bytes, and the loop between them.

pub mod uart;

#[cfg(not(feature = "emulated"))]
use core_algos::bus::Axle;
use core_algos::hil::{Endpoint, Identity};
use core_algos::node::board::Role;
use embassy_stm32::Peripherals;
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::StaticCell;

#[cfg(feature = "emulated")]
use crate::emulated::{self, options::Options, pipe::Pipe};
use crate::watchdog::Watchdog;
use crate::{fault, stack};

/// How bytes come and go.
pub trait Link {
    /// Waits for bytes; the number read, at least one.
    fn read(&mut self, buffer: &mut [u8]) -> impl Future<Output = usize>;

    /// Writes all bytes, waiting for room.
    fn write(&mut self, bytes: &[u8]);
}

/// What an image is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Front or rear axle, as the strap says.
    Axle,
    /// The instrumented frame.
    Beam,
}

/// Longest wait for bytes before the watchdog is fed all the same.
const IDLE: Duration = Duration::from_millis(100);
/// Time between two reports in the log.
const REPORT: Duration = Duration::from_secs(10);

/// Runs the board's nodes behind its link, for ever. `build` says what the image was built from.
#[cfg(not(feature = "emulated"))]
pub async fn run(p: Peripherals, kind: Kind, build: &'static str) -> ! {
    let watchdog = Watchdog::start(p.IWDG);
    let role = match kind {
        Kind::Axle => match crate::strap::axle(p.PC13) {
            Axle::Front => Role::Front,
            Axle::Rear => Role::Rear,
        },
        Kind::Beam => Role::Beam,
    };
    let link = uart::Uart::new(p.USART3, p.PB11, p.PB10);
    serve(link, watchdog, Identity { build, role }).await
}

/// Runs the board's nodes behind the link that the command line names, for ever. `build` says what
/// the image was built from.
#[cfg(feature = "emulated")]
pub async fn run(p: Peripherals, kind: Kind, build: &'static str) -> ! {
    let watchdog = Watchdog::start(p.IWDG);
    let options = Options::read();
    let role = match (kind, options.get("role")) {
        (Kind::Axle, Some("front")) => Role::Front,
        (Kind::Axle, Some("rear")) => Role::Rear,
        (Kind::Beam, Some("beam") | None) => Role::Beam,
        _ => emulated::refuse("role= must be front or rear for an axle, beam for the beam"),
    };
    let identity = Identity { build, role };
    match options.get("link") {
        Some("pipe") => match Pipe::open(&options) {
            Some(pipe) => serve(pipe, watchdog, identity).await,
            None => emulated::refuse("in= and out= must name two pipes"),
        },
        Some("uart") => {
            let link = uart::Uart::emulated(p.USART2, p.PA3, p.PA2, p.USART3, p.PB11, p.PB10);
            serve(link, watchdog, identity).await
        }
        _ => emulated::refuse("link= must be pipe or uart"),
    }
}

/// Answers what the link brings, for ever. The watchdog is fed once a turn: a node that does not
/// return from a step lets it reset the board.
async fn serve(mut link: impl Link, mut watchdog: Watchdog, identity: Identity) -> ! {
    static ENDPOINT: StaticCell<Endpoint> = StaticCell::new();
    let endpoint = ENDPOINT.init_with(|| Endpoint::new(identity));
    defmt::info!("{}: {} in the loop", identity.build, identity.role.name());
    let mut buffer = [0; 256];
    let mut next_report = Instant::now() + REPORT;
    loop {
        watchdog.feed();
        if let Ok(count) = with_timeout(IDLE, link.read(&mut buffer)).await {
            endpoint.receive(&buffer[..count], &mut |reply| link.write(reply));
        }
        if Instant::now() >= next_report {
            next_report += REPORT;
            report(endpoint);
        }
    }
}

fn report(endpoint: &Endpoint) {
    let frames = endpoint.counters();
    let (used, size) = stack::high_water();
    defmt::info!(
        "frames {} whole, {} damaged; stack {} of {} bytes; {}",
        frames.received,
        frames.damaged,
        used,
        size,
        fault::counts()
    );
}
