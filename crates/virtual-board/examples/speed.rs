//! Measures the speed of the core in instructions per second, with a small loop and with an image that uses semihosting
//! (`speed ELF`).

mod flat;

use flat::Flat;
use flat::semihosting::serve;
use std::time::Instant;
use virtual_board::core::{Core, Stop};
use virtual_board::image::Image;

/// Loop of r3 iterations that loads, sums and stores words of a table.
const LOOP: [u16; 14] = [
    0x2000, // movs r0, #0
    0x4906, // ldr r1, [pc, #24]
    0xf851, 0x2b04, // loop: ldr r2, [r1], #4
    0x1880, // adds r0, r0, r2
    0x3b01, // subs r3, #1
    0xea80, 0x1050, // eor r0, r0, r0, lsr #5
    0x600a, // str r2, [r1]
    0xf021, 0x0180, // bic r1, r1, #128
    0x2b00, // cmp r3, #0
    0xd1f4, // bne loop
    0xbe00, // bkpt
];

fn small_loop() {
    let mut best = 0.0f64;
    for _ in 0..10 {
        let mut flat = Flat::default();
        let mut core = Core::new();
        let mut image: Vec<u8> = [0x2000_8000u32, 0x0800_0009]
            .iter()
            .flat_map(|w| w.to_le_bytes())
            .collect();
        image.extend(LOOP.iter().flat_map(|h| h.to_le_bytes()));
        image.resize(64, 0);
        flat.program(0, &image);
        flat.flash[0x24..0x28].copy_from_slice(&0x2000_0000u32.to_le_bytes());
        core.reset(&mut flat);
        core.attach_debugger(true);
        core.set_register(3, 5_000_000);
        let begin = Instant::now();
        let stop = core.run(&mut flat, u64::MAX);
        let seconds = begin.elapsed().as_secs_f64();
        assert!(matches!(stop, Stop::Breakpoint(_)), "{stop:?}");
        best = best.max(core.instructions() as f64 / seconds / 1e6);
    }
    println!("small loop: {best:.0} MIPS");
}

/// Runs an image to its end; returns instructions, cycles and seconds of wall-clock time.
fn run(image: &Image, loud: bool) -> (u64, u64, f64) {
    let (mut core, mut flat) = Flat::start(image);
    let begin = Instant::now();
    loop {
        match core.run(&mut flat, u64::MAX) {
            Stop::Breakpoint(_) if serve(&mut core, &mut flat, loud).is_none() => {}
            Stop::Breakpoint(_) => break,
            stop => panic!("{stop:?} at {:#x}: {:?}", core.pc(), flat.notes),
        }
    }
    let seconds = begin.elapsed().as_secs_f64();
    for note in &flat.notes {
        println!("{note}");
    }
    (core.instructions(), core.cycles(), seconds)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    small_loop();
    for path in std::env::args().skip(1) {
        let image = Image::open(path.as_ref())?;
        let (instructions, cycles, first) = run(&image, true);
        let best = (0..9).fold(first, |best, _| best.min(run(&image, false).2));
        let mips = instructions as f64 / best / 1e6;
        println!("{instructions} instructions, {cycles} cycles: {mips:.0} MIPS");
    }
    Ok(())
}
