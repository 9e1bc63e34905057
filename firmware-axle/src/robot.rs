//! The image that drives the robot.
//!
//! By priority: current loop (interrupt of the converter, 20 kHz) → handlers of the bus → tick
//! (1 kHz, with the lead node on the front board) → bus → log.

mod encoders;
mod inertial;
mod motors;
mod operator;
mod telemetry;
mod tick;

use core::sync::atomic::AtomicU32;

use core_algos::config::ConfigError;
use core_algos::node::board::Board;
use core_algos::node::robot::RobotConfig;
use core_algos::params::Settings;
use embassy_executor::Spawner;
use embassy_stm32::Peripherals;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch::Watch;
use firmware_common::store::chip::Parameters;
use firmware_common::watchdog::Watchdog;
use firmware_common::{board, can, executors, strap};
use static_cell::StaticCell;

use encoders::Encoders;
use inertial::Inertial;
use motors::Motors;
use operator::Button;
use tick::{Axis, Report};

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let p = board::start();
    match start(p).await {
        Ok((reports, attendance)) => telemetry::run(reports, attendance).await,
        Err(error) => {
            // Nothing was started: the motors stay off, and the watchdog is not fed.
            defmt::error!("configuration: {} = {}", error.field, error.value);
        }
    }
}

/// Builds everything and starts it; what is left for the caller is the log.
async fn start(p: Peripherals) -> Result<(telemetry::Reports, telemetry::Attendance), ConfigError> {
    static REPORTS: Watch<CriticalSectionRawMutex, Report, 1> = Watch::new();
    static COUNTS: [AtomicU32; telemetry::TASKS.len()] =
        [const { AtomicU32::new(0) }; telemetry::TASKS.len()];

    let role = tick::role(strap::axle(p.PC13));
    let base = Settings::of(role);
    let (settings, parameters) = Parameters::load(p.FLASH, base, role).await;
    let config = settings.robot;
    let nodes = nodes(&config, role)?;
    let geometry = &config.geometry;
    let straight_m = geometry.frame_length_m + 2.0 * geometry.rigid_end_m;
    let sigmas = config.lead.fusion.frame_sigmas;
    let observer = config.completed().axle.wheel.build()?;
    let winding = settings.drive.winding().build()?;

    let (attendance, badges) =
        telemetry::Attendance::start(&COUNTS, telemetry::TASKS, Watchdog::start(p.IWDG));
    let [of_drive, of_tick, of_bus] = badges;
    let (sender, receiver) = can::start(p.CAN1, p.PB8, p.PB9);
    let encoders = Encoders::start((p.TIM3, p.PC6, p.PC7), (p.TIM4, p.PB6, p.PB7));
    let inertial = Inertial::start(p.SPI1, p.PA4, p.PA5, p.PA6, p.PA7, &settings.inertial).await?;
    let parts = motors::Parts {
        adc: p.ADC1,
        timer: p.TIM1,
        enable: (p.PA8, p.PA9),
        direction: (p.PB14, p.PB15),
        sleep: p.PB13,
        fault: (p.PC8, p.PC9),
        current: (p.PC0, p.PC1),
        supply: p.PC2,
        temperature: p.PC3,
        stop: p.PB12,
        badge: of_drive,
    };
    let motors = Motors::start(parts, &settings.drive)?;

    let spawners = executors::start();
    defmt::info!("{} axle", role.name());
    // Each of these tasks is spawned once, and has room for one.
    spawners
        .bus
        .spawn(can::supervise(of_bus).expect("spawned once"));
    let axis = Axis {
        motors,
        encoders,
        inertial,
        button: Button::new(p.PA0, straight_m, sigmas),
        sender,
        receiver,
        nodes,
        observer,
        winding,
        drive: settings.drive,
        parameters: parameters.report.conditions(),
        reports: REPORTS.sender(),
        badge: of_tick,
    };
    spawners.tick.spawn(tick::run(axis).expect("spawned once"));
    Ok((REPORTS.receiver().expect("the only one"), attendance))
}

/// The nodes in their static place, and a copy as they are at the start.
#[inline(never)]
fn nodes(
    config: &RobotConfig,
    role: core_algos::node::board::Role,
) -> Result<(&'static mut Board, &'static Board), ConfigError> {
    static NOW: StaticCell<Board> = StaticCell::new();
    static AT_START: StaticCell<Board> = StaticCell::new();
    let at_start = AT_START.init(Board::new(config, role)?);
    Ok((NOW.init(at_start.clone()), at_start))
}
