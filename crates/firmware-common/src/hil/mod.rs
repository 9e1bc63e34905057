//! Hardware in the loop: the board's nodes fed from a serial link instead of sensors and bus.
//!
//! The endpoint in `core-algos` holds the nodes and speaks the protocol; here are the links that
//! carry its bytes, and the loop between them.

#[cfg(not(feature = "emulated"))]
mod real;
pub mod uart;

use core_algos::hil::protocol::StackUse;
use core_algos::hil::{Endpoint, Identity};
use embassy_time::{Duration, Instant, with_timeout};
use embedded_storage_async::nor_flash::NorFlash;
use static_cell::StaticCell;

use crate::store::Store;
use crate::watchdog::Watchdog;
use crate::{fault, stack};

#[cfg(not(feature = "emulated"))]
pub use real::run;

/// Byte link to the host.
pub trait Link {
    /// Waits for bytes; the number read, at least one.
    fn read(&mut self, buffer: &mut [u8]) -> impl Future<Output = usize>;

    /// Writes all bytes, waiting for room.
    fn write(&mut self, bytes: &[u8]);
}

/// Purpose of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Front or rear axle, as the strap says.
    Axle,
    /// The instrumented frame.
    Beam,
}

/// Longest wait for bytes before the watchdog is fed all the same.
const IDLE: Duration = Duration::from_millis(100);
/// Time of the first report in the log, and between later ones.
const FIRST_REPORT: Duration = Duration::from_secs(1);
const REPORT: Duration = Duration::from_secs(10);

/// Answers what the link brings, for ever. The watchdog is fed once a turn: a node that does not
/// return from a step lets it reset the board.
pub async fn serve(
    mut link: impl Link,
    mut watchdog: Watchdog,
    identity: Identity,
    mut store: Store<impl NorFlash>,
) -> ! {
    watchdog.shorten();
    let endpoint = endpoint(identity);
    endpoint.load(store.load().await);
    defmt::info!("{}: {} in the loop", identity.build, identity.role.name());
    let mut buffer = [0; 256];
    let mut next_report = Instant::now() + FIRST_REPORT;
    loop {
        watchdog.feed();
        if let Ok(count) = with_timeout(IDLE, link.read(&mut buffer)).await {
            endpoint.receive(&buffer[..count], &mut |reply| link.write(reply));
            if let Some(save) = endpoint.save() {
                watchdog.lengthen();
                let saved = store.save(&save.settings, &save.base, save.off).await;
                watchdog.shorten();
                if let Err(error) = saved {
                    defmt::warn!("parameters not saved: {}", defmt::Debug2Format(&error));
                }
                let done = saved.ok().map(|values| (values, store.contents()));
                endpoint.saved(done, &mut |reply| link.write(reply));
            }
        }
        if Instant::now() >= next_report {
            next_report += REPORT;
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
