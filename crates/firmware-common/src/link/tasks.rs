//! Tasks of the link: one of a board that drives, one of a session.

use core::future::pending;

use core_algos::link::protocol::StackUse;
use core_algos::link::run_link::REPORT_MS;
use core_algos::link::segment::{self, Direction};
use core_algos::link::{Identity, RunLink, SessionNodes};
use core_algos::node::robot::RobotConfig;
use core_algos::topology::Role;
use embassy_executor::Spawner;
use embassy_futures::select::{Either3, select3};
use embassy_stm32::Peri;
use embassy_stm32::peripherals::{PB10, PB11, USART3};
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::{ConstStaticCell, StaticCell};

use super::driving::{Driving, Event};
use super::ends::{Channels, LinkEnd, TickEnd};
use super::ports::Ports;
use super::uart::{self, Uart};
use super::{Output, Route, request};
use crate::can::{self, Bus, ServicePort};
use crate::store::chip::Parameters;
use crate::watchdog::Watchdog;
use crate::{fault, stack};

/// Longest wait of a link task for an event; a session feeds the watchdog after each wait.
const IDLE: Duration = Duration::from_millis(100);
/// Time between reports to a host that watches.
const REPORT_EVERY: Duration = Duration::from_millis(REPORT_MS);
/// Time without a request after which a session ends.
const SILENCE: Duration = Duration::from_secs(60);
/// Time between two reports of a session in the log.
const REPORT: Duration = Duration::from_secs(10);

/// Splits the static channels of this board into the tick's end and the link's end; call it once.
pub fn ends() -> (TickEnd, LinkEnd) {
    static CHANNELS: ConstStaticCell<Channels> = ConstStaticCell::new(Channels::new());
    CHANNELS.take().split()
}

/// Opened serial port, and the identity that the board reports.
pub struct Link {
    uart: Uart,
    identity: Identity,
}

impl Link {
    /// Opens the serial port; call it once. `build` names the image.
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

    /// Starts the link task of a board that drives with nodes of this configuration.
    pub fn start_driving(
        self,
        config: &'static RobotConfig,
        service: ServicePort,
        end: LinkEnd,
        spawner: Spawner,
    ) {
        spawner.spawn(drive(self, config, service, end).expect("spawned once"));
    }

    /// Starts a session with its nodes in `nodes`; `bus` is given for a session over the bus.
    pub fn start_session(
        self,
        watchdog: Watchdog,
        parameters: &'static mut Parameters,
        bus: Option<Bus>,
        nodes: &'static mut dyn SessionNodes,
        spawner: Spawner,
    ) {
        let service = bus.map(|bus| {
            let task = can::run_session_bus(bus.sender, bus.receiver);
            spawner.spawn(task.expect("spawned once"));
            bus.service
        });
        spawner.spawn(serve(self, service, watchdog, parameters, nodes).expect("spawned once"));
    }
}

/// Serves the link of a board that drives, for ever.
#[embassy_executor::task]
async fn drive(link: Link, config: &'static RobotConfig, service: ServicePort, end: LinkEnd) -> ! {
    static RUN_LINKS: StaticCell<[RunLink; 2]> = StaticCell::new();
    let Link { uart, identity } = link;
    let run_link = || RunLink::new(identity, config, stack_use, fault::record);
    let run_links = RUN_LINKS.init_with(|| [(); 2].map(|()| run_link()));
    let mut driving = Driving::new(identity.role, run_links, end);
    let mut ports = Ports {
        uart,
        service: Some(service),
    };
    let mut buffer = [0; 64];
    loop {
        let end = driving.end();
        let wait = match end.is_watched() {
            true => REPORT_EVERY,
            false => IDLE,
        };
        // If entries are left over, the next report follows at once.
        let is_behind = end.is_behind();
        let sent = async {
            match is_behind {
                true => uart::sent().await,
                false => pending().await,
            }
        };
        let ended = select3(ports.receive(&mut buffer), sent, end.result());
        let event = match with_timeout(wait, ended).await {
            Ok(Either3::First(event)) => event,
            Ok(Either3::Third(result)) => Event::Executed(result),
            Ok(Either3::Second(())) | Err(_) => Event::Nothing,
        };
        if let Some(route) = driving.handle_event(Instant::now().as_micros(), event, &mut ports) {
            ports.flush(route).await;
            defmt::info!("reset to start a session");
            request::restart(Some(route));
        }
    }
}

/// Serves a session until the host ends it or is silent for [`SILENCE`]. The watchdog is fed once per turn, so a node
/// step that hangs resets the board.
#[embassy_executor::task]
async fn serve(
    link: Link,
    service: Option<ServicePort>,
    watchdog: Watchdog,
    parameters: &'static mut Parameters,
    nodes: &'static mut dyn SessionNodes,
) -> ! {
    let Link { uart, identity } = link;
    let role = identity.role;
    let route = match service {
        Some(_) => Route::Bus,
        None => Route::Serial,
    };
    let mut ports = Ports { uart, service };
    let (mut feeder, mut extension) = watchdog.split();
    let sim_link = sim_link(identity, nodes);
    sim_link.load(parameters.contents());
    let robot = parameters.settings.robot.topology();
    defmt::info!("{}: session", robot.name(role));
    let mut buffer = [0; 256];
    let (mut asked, mut reported) = (Instant::now(), Instant::now());
    loop {
        feeder.feed();
        let event = with_timeout(IDLE, ports.receive(&mut buffer)).await;
        let bytes = match &event {
            Ok(Event::Bytes(bytes)) if route == Route::Serial => bytes,
            Ok(Event::Frame(frame))
                if segment::address(frame.id) == Some((role, Direction::To)) =>
            {
                frame.bytes()
            }
            _ => &[],
        };
        if !bytes.is_empty() {
            let mut send = |reply: &[u8]| ports.reply(route, role, reply);
            sim_link.receive(bytes, &mut send);
            if let Some(save) = sim_link.save() {
                let values = extension.during(|| parameters.write(&save.settings, save.off));
                let done = values.map(|values| (values, parameters.contents()));
                sim_link.saved(done, &mut send);
            }
            asked = Instant::now();
        }
        if sim_link.has_ended() || asked.elapsed() > SILENCE {
            ports.flush(route).await;
            defmt::info!("end of the session");
            request::restart(None);
        }
        if reported.elapsed() > REPORT {
            reported = Instant::now();
            report(sim_link);
        }
    }
}

/// Simulation link of an image, with the nodes elsewhere in its memory.
type SimLink = core_algos::link::SimLink<&'static mut dyn SessionNodes>;

/// Simulation link in static memory. Not inlined, so that its 6 kB, if built on the stack, enlarge no caller's frame.
#[inline(never)]
fn sim_link(identity: Identity, nodes: &'static mut dyn SessionNodes) -> &'static mut SimLink {
    static SIM_LINK: StaticCell<SimLink> = StaticCell::new();
    SIM_LINK.init_with(|| SimLink::with_nodes(identity, stack_use, nodes))
}

/// Logs the stack use and returns it for the host.
fn stack_use() -> StackUse {
    let stack = stack::high_water();
    defmt::info!("{}", stack);
    StackUse {
        used_bytes: stack.used as u32,
        budget_bytes: stack.budget as u32,
        size_bytes: stack.size as u32,
    }
}

fn report(sim_link: &SimLink) {
    let frames = sim_link.counters();
    defmt::info!(
        "frames {} whole, {} damaged; {}; {}",
        frames.received,
        frames.damaged,
        stack::high_water(),
        fault::counts()
    );
}
