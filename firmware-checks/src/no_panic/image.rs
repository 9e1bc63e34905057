//! The image.

use core::hint::black_box;
use core_algos::beam::MAX_GAUGES;
use core_algos::bus::{self, Frame};
use core_algos::node::board::{Board, Samples};
use core_algos::node::{Outbox, axle};
use cortex_m_rt::entry;

unsafe extern "Rust" {
    safe fn a_node_step_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    a_node_step_can_panic()
}

/// A tick of a board with samples and frames that the compiler knows nothing of.
#[inline(never)]
fn tick(board: &mut Board, outbox: &mut Outbox) {
    let now = black_box(0);
    if let Ok(message) = bus::decode(&black_box(Frame {
        id: 0,
        length: 0,
        data: [0; 8],
    })) {
        board.receive(now, &message);
    }
    let samples = if black_box(false) {
        Samples::Axle(black_box(axle::Samples::default()))
    } else {
        Samples::Beam(black_box([0; MAX_GAUGES]))
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

#[entry]
fn main() -> ! {
    static mut BOARD: Option<Board> = None;
    let mut outbox = Outbox::new();
    loop {
        if let Some(board) = black_box(&mut *BOARD) {
            tick(board, &mut outbox);
        }
    }
}
