//! Firmware image that contains one tick of a board and of its periphery.

use core::hint::black_box;
use core_algos::acquisition::analog::{Supply, Thermistor};
use core_algos::acquisition::{inertial, oversampling};
use core_algos::beam::procedure::{Event, Procedure};
use core_algos::beam::{MAX_GAUGES, calibration};
use core_algos::bus::{self, CanFrame, Message};
use core_algos::drive::bridge;
use core_algos::drive::count::Extended;
use core_algos::drive::current::{self, CurrentLoop};
use core_algos::drive::shunt::{Shunt, Zeroing};
use core_algos::drive::winding::{self, Winding};
use core_algos::node::board::{Board, Samples};
use core_algos::node::tick_sync::TickSync;
use core_algos::node::{Outbox, axle};
use core_algos::topology::FrameId;
use cortex_m_rt::entry;

unsafe extern "Rust" {
    safe fn a_node_step_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    a_node_step_can_panic()
}

/// Runs a tick of a board with samples and frames whose values the compiler does not know.
#[inline(never)]
fn tick(board: &mut Board, outbox: &mut Outbox) {
    let now = black_box(0);
    if let Ok(message) = bus::decode(&black_box(CanFrame {
        id: 0,
        length: 0,
        data: [0; 8],
    })) {
        board.receive(now, &message);
    }
    let samples = if black_box(false) {
        Samples::Axle(black_box(axle::Samples::default()))
    } else {
        Samples::Beam(black_box([0; MAX_GAUGES]).into())
    };
    black_box(board.step(now, &samples, outbox));
    for message in outbox.iter() {
        let _ = black_box(bus::encode(message));
    }
    outbox.clear();
    if cfg!(feature = "panic") {
        black_box([0u8; 4][black_box(4_usize)]);
    }
}

/// Algorithms between a board's peripherals and its nodes.
struct Periphery {
    sync: TickSync,
    current_loop: (CurrentLoop, current::State),
    winding: (Winding, winding::State),
    shunt: (Shunt, Zeroing),
    encoder: Extended,
    gyro: inertial::Channel,
    thermistor: Thermistor,
    supply: Supply,
    procedure: Procedure,
    calibration: calibration::Config,
}

/// Runs a tick of the periphery with values that the compiler does not know.
#[inline(never)]
fn peripheral_tick(p: &mut Periphery) {
    if let Ok(message) = bus::decode(&black_box(CanFrame {
        id: 0,
        length: 0,
        data: [0; 8],
    })) {
        p.sync.receive(black_box(0), &message);
        if let Message::BeamCalibration {
            frame: FrameId(0),
            sequence,
            calibrate,
        } = message
        {
            p.procedure.request(sequence, calibrate);
        }
    }
    black_box(p.sync.step(black_box(0)));
    black_box(p.sync.sync(black_box(0), black_box(None)));
    let output = p
        .current_loop
        .0
        .step(&mut p.current_loop.1, &black_box(current::Input::default()));
    black_box(bridge::pins(output.duty, black_box(0)));
    black_box(
        p.winding
            .0
            .step(&mut p.winding.1, black_box(0.0), black_box(0.0)),
    );
    black_box(p.shunt.1.step(&p.shunt.0, black_box(0)));
    black_box(p.shunt.0.read(black_box(0), black_box(0.0)));
    black_box(p.encoder.step(black_box(0)));
    black_box(p.gyro.step(black_box(0), black_box(false)));
    black_box(p.thermistor.read(black_box(0.0), black_box(0.0)));
    black_box(p.supply.read(black_box(0)));
    let samples = black_box([0u16; 6 * oversampling::SCANS]);
    let sums = oversampling::sums::<6>(&samples);
    black_box(oversampling::ratiometric(sums[0], sums[5], black_box(0)));
    let counts = black_box([0; MAX_GAUGES]);
    let event = p
        .procedure
        .sample(&p.calibration, &counts, black_box(false));
    if let Some(Event::Adopt { config, .. }) = event {
        p.calibration = config;
    }
}

#[entry]
fn main() -> ! {
    static mut BOARD: Option<Board> = None;
    static mut PERIPHERY: Option<Periphery> = None;
    let mut outbox = Outbox::new();
    loop {
        if let Some(board) = black_box(&mut *BOARD) {
            tick(board, &mut outbox);
        }
        if let Some(periphery) = black_box(&mut *PERIPHERY) {
            peripheral_tick(periphery);
        }
    }
}
