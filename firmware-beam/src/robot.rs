//! The image that drives the robot.
//!
//! By priority: handlers of the bus → tick (1 kHz, when the converter's samples are there) → bus →
//! thread (link, watchdog, log and store).

mod background;
mod bridges;
mod tick;
mod watchdog;

use core::sync::atomic::AtomicU32;

use core_algos::acquisition::analog::ThermistorConfig;
use core_algos::beam::calibration::StandstillLimits;
use core_algos::beam::procedure::Procedure;
use core_algos::config::ConfigError;
use core_algos::node::beam::BeamNode;
use core_algos::node::robot::RobotConfig;
use core_algos::node::tick_sync::TickSync;
use core_algos::params::BoardKind;
use core_algos::topology::{FrameId, Role};
use embassy_executor::Spawner;
use embassy_stm32::adc::AdcChannel;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::{Peripherals, uid};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_sync::watch::Watch;
use firmware_common::identity::Identity;
use firmware_common::led::Led;
use firmware_common::link::{self, Link, Route};
use firmware_common::store::chip::Parameters;
use firmware_common::tick_loop::{Chip, Common, TickLoop};
use firmware_common::watchdog::Watchdog;
use firmware_common::{board, can, executors};
use static_cell::StaticCell;

use bridges::Bridges;
use tick::{Beam, BeamReport, BeamTick, Saving};
use watchdog::TaskWatchdog;

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let watchdog = Watchdog::start();
    if let Err(error) = start(board::start(env!("BUILD")), watchdog, spawner) {
        // Nothing was started, and the watchdog, which is not fed, resets the board.
        defmt::error!("configuration: {} = {}", error.field, error.value);
    }
}

/// Builds and starts all parts of the board, or a session if one was requested. Log and store are a task too, so that
/// the stack used by this function is freed.
fn start(p: Peripherals, watchdog: Watchdog, spawner: Spawner) -> Result<(), ConfigError> {
    static REPORTS: Watch<CriticalSectionRawMutex, BeamReport, 1> = Watch::new();
    static COUNTS: [AtomicU32; watchdog::TASKS.len()] =
        [const { AtomicU32::new(0) }; watchdog::TASKS.len()];
    static SAVING: Saving = Saving {
        wanted: Signal::new(),
        done: Signal::new(),
    };

    let parameters = Parameters::load(p.FLASH, BoardKind::Beam);
    let role = parameters.role;
    let link = Link::open(p.USART3, p.PB11, p.PB10, role, env!("BUILD"));
    let (tick_end, link_end) = link::ends();
    if let Some(route) = link::requested_session() {
        let start = || can::start(p.CAN1, p.PB8, p.PB9, tick_end.recorder());
        let bus = (route == Route::Bus).then(start);
        link.start_session(watchdog, parameters, bus, session_node(), spawner);
        return Ok(());
    }
    let settings = &parameters.settings;
    let node = build(&settings.robot, role)?;
    defmt::info!("{}", settings.robot.topology().name(role));
    let limits = StandstillLimits::default().build()?;
    let procedure = Procedure::new(limits, settings.robot.geometry.half_thickness_m);
    let thermistor = ThermistorConfig::default().build()?;

    let (feeder, extension) = watchdog.split();
    let (task_watchdog, check_ins) = TaskWatchdog::new(&COUNTS, watchdog::TASKS, feeder);
    let [of_tick, of_bus] = check_ins;
    let bus = can::start(p.CAN1, p.PB8, p.PB9, tick_end.recorder());
    interrupt::DMA2_STREAM0.set_priority(Priority::P4);
    let spawners = executors::start();
    // `expect` cannot fail: each task has room for one instance and is spawned once.
    spawners
        .bus
        .spawn(can::supervise(of_bus).expect("spawned once"));
    let bridges = Bridges::start(
        bridges::Parts {
            adc: p.ADC1,
            dma: p.DMA2_CH0,
            timer: p.TIM2,
            bridges: [
                p.PC0.degrade_adc(),
                p.PC1.degrade_adc(),
                p.PC2.degrade_adc(),
                p.PC3.degrade_adc(),
                p.PA1.degrade_adc(),
            ],
            excitation: p.PA2,
            temperature: p.PA3,
        },
        thermistor,
    );
    let identity = Identity::new(&uid::uid(), env!("BUILD"));
    let chip = Chip::new(Led::new(p.PC12), bus.sender, bus.receiver, of_tick);
    let common = Common::new(role, chip, tick_end, TickSync::following(), identity);
    let tick = BeamTick::new(Beam {
        bridges,
        config: settings.robot,
        node,
        procedure,
        saving: &SAVING,
        parameters: parameters.report.conditions(),
    });
    let tick = TickLoop::new(tick, common, REPORTS.sender());
    spawners.tick.spawn(tick::run(tick).expect("spawned once"));
    link.start_driving(copy(&settings.robot), bus.service, link_end, spawner);
    spawner.spawn(watchdog::run(task_watchdog).expect("spawned once"));
    let reports = REPORTS.receiver().expect("the only one");
    let background = background::run(reports, parameters, &SAVING, extension);
    spawner.spawn(background.expect("spawned once"));

    Ok(())
}

/// Place of the node of a session.
fn session_node() -> &'static mut Option<BeamNode> {
    static NODE: StaticCell<Option<BeamNode>> = StaticCell::new();
    NODE.init_with(|| None)
}

/// Copy of the configuration at the start, because the store changes the parameters.
fn copy(config: &RobotConfig) -> &'static RobotConfig {
    static CONFIG: StaticCell<RobotConfig> = StaticCell::new();
    CONFIG.init_with(|| *config)
}

/// Builds the node. Not inlined, so that its configuration does not stay on the stack.
#[inline(never)]
fn build(config: &RobotConfig, role: Role) -> Result<BeamNode, ConfigError> {
    let frame = match role {
        Role::Beam(frame) => frame,
        // A beam board never has the role of an axle.
        Role::Axle(_) => FrameId(0),
    };
    config.build_beam(frame)
}
