//! The image that drives the robot.
//!
//! By priority: current loop (interrupt of the converter, 20 kHz) → handlers of the bus → tick
//! (1 kHz, with the lead node on the front board) → bus → thread (link, watchdog, log).

mod encoders;
mod inertial;
mod motors;
mod operator;
mod telemetry;
mod tick;
mod watchdog;

use core::sync::atomic::AtomicU32;

use core_algos::config::ConfigError;
use core_algos::control::controller::KinematicController;
use core_algos::control::wheel_observer::WheelObserver;
use core_algos::drive::winding::Winding;
use core_algos::fusion::estimator::Estimator;
use core_algos::node::board::{Board, Ready};
use core_algos::node::robot::ConfiguredPlacement;
use core_algos::node::tick_sync::TickSync;
use core_algos::params::Settings;
use core_algos::topology::Role;
use embassy_executor::Spawner;
use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::pac::{GPIOC, RCC};
use embassy_stm32::peripherals::PA0;
use embassy_stm32::{Peri, Peripherals, uid};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch::Watch;
use firmware_common::board_id::Strap;
use firmware_common::identity::Identity;
use firmware_common::led::Led;
use firmware_common::link::{self, Link, Route};
use firmware_common::store::chip::Parameters;
use firmware_common::tick_loop::{Chip, Common, TickLoop};
use firmware_common::watchdog::Watchdog;
use firmware_common::{board, can, executors, fault};
use static_cell::StaticCell;

use encoders::Encoders;
use inertial::Inertial;
use motors::Motors;
use operator::Button;
use tick::{Axle, AxleReport, AxleTick};
use watchdog::TaskWatchdog;

/// Parts of the user on the front board; `None` keeps the built-in part. The lead node's step has 1 ms for both fusions
/// and the controller.
#[derive(Default)]
pub struct Own {
    /// Replaces the regulator.
    pub controller: Option<&'static mut (dyn KinematicController + Send)>,
    /// Replaces the estimates of the fusion.
    pub estimator: Option<&'static mut (dyn Estimator + Send)>,
}

/// Runs the board with parts of the user.
pub fn run(spawner: Spawner, own: Own) {
    drivers_asleep();
    fault::on_fault(drivers_asleep);
    let watchdog = Watchdog::start();
    if let Err(error) = start(board::start(env!("BUILD")), watchdog, own, spawner) {
        // Nothing was started: the motors stay off, and the watchdog, which is not fed, resets the board.
        defmt::error!("configuration: {} = {}", error.field, error.value);
    }
}

/// Makes the pin of nSLEEP an output and pulls it low: both drivers sleep. This is the safe state before the motors are
/// started.
fn drivers_asleep() {
    RCC.ahb1enr().modify(|w| w.set_gpiocen(true));
    // The port's clock starts two cycles after it is enabled (ES0182).
    cortex_m::asm::dsb();
    GPIOC.bsrr().write(|w| w.set_br(motors::SLEEP, true));
    GPIOC
        .moder()
        .modify(|w| w.set_moder(motors::SLEEP, Moder::OUTPUT));
}

/// Builds and starts all parts of the board, or a session if one was requested. The log is a task too, so that the
/// stack used by this function is freed.
fn start(
    p: Peripherals,
    watchdog: Watchdog,
    own: Own,
    spawner: Spawner,
) -> Result<(), ConfigError> {
    static REPORTS: Watch<CriticalSectionRawMutex, AxleReport, 1> = Watch::new();
    static COUNTS: [AtomicU32; watchdog::TASKS.len()] =
        [const { AtomicU32::new(0) }; watchdog::TASKS.len()];

    let parameters = Parameters::load(p.FLASH, Strap::read(p.PC13).kind());
    let role = parameters.role;
    let link = Link::open(p.USART3, p.PB11, p.PB10, role, env!("BUILD"));
    let (tick_end, link_end) = link::ends();
    if let Some(route) = link::requested_session() {
        let start = || can::start(p.CAN1, p.PB8, p.PB9, tick_end.recorder());
        let bus = (route == Route::Bus).then(start);
        link.start_session(watchdog, parameters, bus, place(), spawner);
        return Ok(());
    }
    let parameters: &'static Parameters = parameters;
    let settings = &parameters.settings;
    let built = build(settings, role)?;
    let nodes = built.nodes.begin_in(place());
    let button = button(p.PA0, settings);

    // With a running window watchdog the board never erases flash, so the timeout of `watchdog` is never extended.
    let (feeder, _) = watchdog.split();
    let (task_watchdog, check_ins) = TaskWatchdog::new(&COUNTS, watchdog::TASKS, feeder);
    let [of_drive, of_tick, of_bus] = check_ins;
    let bus = can::start(p.CAN1, p.PB8, p.PB9, tick_end.recorder());
    let encoders = Encoders::start((p.TIM3, p.PC6, p.PC7), (p.TIM4, p.PB6, p.PB7));
    let inertial = Inertial::start(p.SPI1, p.PA4, p.PA5, p.PA6, p.PA7, &settings.inertial)?;
    let parts = motors::Parts {
        adc: p.ADC1,
        timer: p.TIM1,
        enable: (p.PA8, p.PA9),
        direction: (p.PB14, p.PB15),
        sleep: p.PC5,
        fault: (p.PC8, p.PC9),
        current: (p.PC0, p.PC1),
        supply: p.PC2,
        temperature: p.PC3,
        stop: p.PB12,
        watchdog: p.WWDG,
        check_in: of_drive,
    };
    let motors = Motors::start(parts, &settings.drive)?;

    let spawners = executors::start();
    defmt::info!("{} axle", settings.robot.topology().name(role));
    // `expect` cannot fail: each task has room for one instance and is spawned once.
    spawners
        .bus
        .spawn(can::supervise(of_bus).expect("spawned once"));
    let identity = Identity::new(&uid::uid(), env!("BUILD"));
    let chip = Chip::new(Led::new(p.PC12), bus.sender, bus.receiver, of_tick);
    let common = Common::new(role, chip, tick_end, clock(role), identity);
    let tick = AxleTick::new(Axle {
        motors,
        encoders,
        inertial,
        button,
        nodes,
        own,
        observer: built.observer,
        winding: built.winding,
        drive: settings.drive,
        parameters: parameters.report.conditions(),
    });
    let tick = TickLoop::new(tick, common, REPORTS.sender());
    spawners.tick.spawn(tick::run(tick).expect("spawned once"));
    spawner.spawn(watchdog::run(task_watchdog).expect("spawned once"));
    let reports = REPORTS.receiver().expect("the only one");
    spawner.spawn(telemetry::run(reports).expect("spawned once"));
    link.start_driving(&settings.robot, bus.service, link_end, spawner);
    Ok(())
}

/// Place of the nodes in static memory, still empty.
fn place() -> &'static mut Option<Board> {
    static NODES: StaticCell<Option<Board>> = StaticCell::new();
    NODES.init_with(|| None)
}

/// Operator's button with the drive that it starts.
fn button(pin: Peri<'static, PA0>, settings: &Settings) -> Button {
    let start = settings.button.start;
    let start = settings
        .robot
        .placement(start, &ConfiguredPlacement::default());
    Button::new(pin, start, settings.button)
}

/// Synchronisation of a board's ticks; the front board's clock is the common time.
fn clock(role: Role) -> TickSync {
    match role {
        Role::LEAD => TickSync::leading(),
        _ => TickSync::following(),
    }
}

/// Objects built from the configuration.
struct Built {
    nodes: Ready,
    observer: WheelObserver,
    winding: Winding,
}

/// Builds the objects. Not inlined, so that their configurations do not stay on the stack.
#[inline(never)]
fn build(settings: &Settings, role: Role) -> Result<Built, ConfigError> {
    let config = &settings.robot;
    Ok(Built {
        nodes: Ready::new(config, role)?,
        observer: config.completed().axle.wheel.build()?,
        winding: settings.drive.winding().build()?,
    })
}
