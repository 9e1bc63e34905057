use super::*;
use crate::chip::testing::shared;
use crate::core::Width;

const PERIPHERAL: u32 = 0x4001_204c;
const FIRST: u32 = 0x2000_0100;
const SECOND: u32 = 0x2000_0200;
/// Widths of the peripheral and of memory.
const HALVES: u32 = 1 << 11 | 1 << 13;

// Registers of stream 0.
const CR: u32 = 0x10;
const NDTR: u32 = 0x14;
const PAR: u32 = 0x18;
const M0AR: u32 = 0x1c;
const M1AR: u32 = 0x20;
const FCR: u32 = 0x24;

/// Stream 0 of DMA2, ADC1's on channel 0, in a world whose places hold the low bits of their address.
struct Bench {
    dma: Dma,
    shared: Shared,
    /// Accesses that were made.
    steps: Vec<Step>,
    /// Items that the peripheral gave.
    given: u32,
    broken: bool,
}

impl Bench {
    fn new(items: u32, fcr: u32, cr: u32) -> Self {
        let mut bench = Self {
            dma: Dma::new(Controller::Dma2),
            shared: shared(),
            steps: Vec::new(),
            given: 0,
            broken: false,
        };
        bench.write(&[
            (NDTR, items),
            (PAR, PERIPHERAL),
            (M0AR, FIRST),
            (M1AR, SECOND),
            (FCR, fcr),
            (CR, cr),
            (CR, cr | EN),
        ]);
        bench
    }

    fn write(&mut self, values: &[(u32, u32)]) {
        for &(offset, value) in values {
            self.dma.write(offset, value, !0, &mut self.shared);
        }
        self.run(0);
    }

    fn read(&mut self, offset: u32) -> u32 {
        self.dma.read(offset, &mut self.shared)
    }

    /// Makes the accesses, as the chip does. Whether a block ended.
    fn run(&mut self, stream: usize) -> bool {
        let mut ended = false;
        loop {
            while let Some(step) = self.dma.step(stream) {
                self.steps.push(step);
                let value = match step {
                    Step::Read(PERIPHERAL, _) => {
                        self.given += 1;
                        // Bytes that tell which they are.
                        (0..4).fold(0, |value, k| {
                            value | ((4 * self.given + k) & 0xff) << (8 * k)
                        })
                    }
                    Step::Read(place, _) => place & 0xffff,
                    Step::Write(..) => 0,
                };
                let result = (!self.broken).then_some(value);
                self.dma.done(stream, step, result, &mut self.shared);
            }
            if !self.dma.end(stream, &mut self.shared) {
                return ended;
            }
            ended = true;
        }
    }

    /// ADC1 asks. Whether a block ended; nothing, if no stream listens.
    fn ask(&mut self) -> Option<bool> {
        let stream = self.dma.listener(Request::Adc1)?;
        self.dma.begin(stream);
        Some(self.run(stream))
    }

    /// Writes to memory since the last call.
    fn written(&mut self) -> Vec<(u32, Width, u32)> {
        let steps = self.steps.drain(..);
        let writes = steps.filter_map(|step| match step {
            Step::Write(place, width, value) => Some((place, width, value)),
            Step::Read(..) => None,
        });
        writes.collect()
    }

    fn flags(&mut self) -> u32 {
        self.read(0x00)
    }

    fn clear(&mut self) {
        self.write(&[(0x08, 0x3d)]);
    }

    fn interrupted(&self) -> bool {
        self.shared.lines == 1 << Interrupt::Dma2Stream0 as u32
    }
}

#[test]
fn a_ring_goes_round_and_tells_of_its_halves() {
    let mut bench = Bench::new(4, 0, HTIE | TCIE | CIRC | MINC | HALVES);
    let mut seen = Vec::new();
    for _ in 0..6 {
        let ended = bench.ask().unwrap();
        assert_eq!(bench.steps[0], Step::Read(PERIPHERAL, Width::Half));
        let (place, width, _) = bench.written()[0];
        assert_eq!(width, Width::Half);
        let flags = bench.flags();
        assert_eq!(bench.interrupted(), flags != 0);
        seen.push((place - FIRST, flags, ended, bench.read(NDTR)));
        bench.clear();
    }
    let expected = [
        (0, 0, false, 3),
        (2, HTIF, false, 2),
        (4, 0, false, 1),
        (6, TCIF, true, 4),
        (0, 0, false, 3),
        (2, HTIF, false, 2),
    ];
    assert_eq!(seen, expected);
    assert!(bench.dma.listener(Request::Spi1Rx).is_none());
}

#[test]
fn a_single_block_ends_and_takes_what_the_peripheral_gave() {
    let mut bench = Bench::new(2, 0, MINC | PINC | HALVES);
    assert_eq!(bench.ask(), Some(false));
    assert_eq!(bench.ask(), Some(true));
    assert_eq!(bench.steps[2], Step::Read(PERIPHERAL + 2, Width::Half));
    assert_eq!(bench.steps[1], Step::Write(FIRST, Width::Half, 0x0504));
    assert_eq!(bench.ask(), None);
    assert_eq!((bench.read(CR) & EN, bench.read(NDTR)), (0, 0));
    assert_eq!(bench.flags(), HTIF | TCIF);
    assert!(!bench.interrupted());
}

#[test]
fn requests_find_their_streams() {
    // RM0090, tables of the requests' mapping: controller, stream, channel.
    for (controller, stream, channel, request) in [
        (Controller::Dma2, 4, 0, Request::Adc1),
        (Controller::Dma2, 2, 3, Request::Spi1Rx),
        (Controller::Dma2, 5, 3, Request::Spi1Tx),
        (Controller::Dma1, 1, 4, Request::Usart3Rx),
        (Controller::Dma1, 4, 7, Request::Usart3Tx),
    ] {
        let (mut dma, mut shared) = (Dma::new(controller), shared());
        let base = 0x18 * stream as u32;
        dma.write(base + NDTR, 1, !0, &mut shared);
        dma.write(base + CR, channel << 25 | EN, !0, &mut shared);
        assert_eq!(dma.listener(request), Some(stream));
        dma.write(base + CR, 0, !0, &mut shared);
        assert_eq!(dma.listener(request), None);
    }
}

#[test]
fn a_running_stream_must_not_be_set_up_and_stops_when_told() {
    let mut bench = Bench::new(4, 0, CIRC | MINC | HALVES);
    for (offset, value) in [(NDTR, 9), (PAR, 0), (M0AR, 0), (FCR, 4), (CR, EN)] {
        let before = bench.read(offset);
        bench.write(&[(offset, value)]);
        assert_eq!(bench.read(offset), before);
    }
    assert_eq!(bench.shared.kinds(), [Kind::Forbidden]);
    bench.ask();
    let cr = bench.read(CR);
    bench.write(&[(CR, cr & !EN)]);
    assert_eq!((bench.flags(), bench.read(NDTR)), (TCIF, 3));
    assert_eq!(bench.ask(), None);
}

#[test]
fn a_stream_does_not_start_with_its_flags_up() {
    let mut bench = Bench::new(4, 0, MINC | HALVES);
    let cr = bench.read(CR);
    bench.write(&[(CR, cr & !EN), (CR, cr)]);
    assert_eq!(bench.shared.kinds(), [Kind::Forbidden]);
    assert_eq!(bench.read(CR) & EN, 0);
    bench.clear();
    bench.write(&[(CR, cr)]);
    assert_eq!(bench.read(CR) & EN, EN);
    bench.ask();
    assert_eq!(bench.written()[0].0, FIRST);
}

#[test]
fn double_buffers_take_turns() {
    let mut bench = Bench::new(2, 0, DBM | MINC | HALVES);
    let mut places = Vec::new();
    for _ in 0..5 {
        bench.ask();
        places.push(bench.written()[0].0);
    }
    let expected = [FIRST, FIRST + 2, SECOND, SECOND + 2, FIRST];
    assert_eq!(places, expected);
    // The idle one may be moved.
    bench.write(&[(M1AR, 0x2000_0400)]);
    assert!(bench.shared.kinds().is_empty());
    (0..2).for_each(|_| assert!(bench.ask().is_some()));
    assert_eq!(bench.written()[1].0, 0x2000_0400);
    // Moving the one in use is an error of the transfer.
    bench.write(&[(M1AR, FIRST)]);
    assert_eq!(bench.flags() & TEIF, TEIF);
    assert_eq!(bench.ask(), None);
}

#[test]
fn a_fifo_is_emptied_at_its_threshold_in_the_widths_of_memory() {
    // Bytes to words at half full.
    let mut bench = Bench::new(12, DMDIS | 1, MINC | 2 << 13);
    for _ in 0..7 {
        bench.ask();
    }
    assert!(bench.written().is_empty());
    assert_eq!(bench.read(FCR) >> 3 & 7, 1, "below a half");
    bench.ask();
    let words = [
        (FIRST, Width::Word, 0x100c_0804),
        (FIRST + 4, Width::Word, 0x201c_1814),
    ];
    assert_eq!(bench.written(), words);
    assert_eq!(bench.read(FCR) >> 3 & 7, 4, "empty");
    // The rest of the block goes at its end.
    for _ in 0..4 {
        bench.ask();
    }
    assert_eq!(bench.written(), [(FIRST + 8, Width::Word, 0x302c_2824)]);
    assert_eq!(bench.flags(), HTIF | TCIF);
}

#[test]
fn a_fifo_unpacks_words_and_gives_up_what_it_holds_when_it_is_switched_off() {
    let mut bench = Bench::new(3, DMDIS | 3, MINC | 2 << 11);
    bench.ask();
    let cr = bench.read(CR);
    assert!(bench.written().is_empty());
    bench.write(&[(CR, cr & !EN)]);
    let bytes: Vec<_> = (0..4).map(|k| (FIRST + k, Width::Byte, 4 + k)).collect();
    assert_eq!(bench.written(), bytes);
    assert_eq!((bench.flags(), bench.read(NDTR)), (TCIF, 2));
}

#[test]
fn towards_a_peripheral_an_item_is_fetched_ahead() {
    let mut bench = Bench::new(2, 0, TO_PERIPHERAL | MINC | HALVES);
    assert_eq!(bench.steps, [Step::Read(FIRST, Width::Half)]);
    bench.steps.clear();
    assert_eq!(bench.ask(), Some(false));
    let expected = [
        Step::Write(PERIPHERAL, Width::Half, 0x100),
        Step::Read(FIRST + 2, Width::Half),
    ];
    assert_eq!(bench.steps, expected);
    bench.steps.clear();
    assert_eq!(bench.ask(), Some(true));
    assert_eq!(bench.steps, [Step::Write(PERIPHERAL, Width::Half, 0x102)]);
}

#[test]
fn towards_a_peripheral_the_fifo_is_filled_and_filled_again() {
    // Words to bytes, filled again at a quarter.
    let cr = TO_PERIPHERAL | CIRC | MINC | 2 << 13;
    let mut bench = Bench::new(20, DMDIS, cr);
    let words = |from: u32, n: u32| (0..n).map(move |k| Step::Read(from + 4 * k, Width::Word));
    assert_eq!(bench.steps, words(FIRST, 4).collect::<Vec<_>>());
    assert_eq!(bench.read(FCR) >> 3 & 7, 5, "full");
    bench.steps.clear();
    for _ in 0..11 {
        bench.ask();
    }
    let bytes = bench.written();
    // The lowest byte of each word first.
    let values: Vec<_> = bytes.iter().map(|byte| byte.2).take(5).collect();
    assert_eq!(values, [0x00, 0x01, 0, 0, 0x04]);
    assert_eq!(bytes.len(), 11);
    bench.ask();
    assert_eq!(bench.steps[1..], words(FIRST + 16, 1).collect::<Vec<_>>());
    for k in 12..20 {
        assert_eq!(bench.ask(), Some(k == 19));
    }
    // The ring begins anew.
    assert_eq!(
        bench.steps[bench.steps.len() - 4..],
        words(FIRST, 4).collect::<Vec<_>>()
    );
}

#[test]
fn a_bus_error_stops_the_stream() {
    let mut bench = Bench::new(4, 0, TEIE | CIRC | MINC | HALVES);
    bench.broken = true;
    assert_eq!(bench.ask(), Some(false));
    assert_eq!((bench.flags(), bench.read(CR) & EN), (TEIF, 0));
    assert!(bench.interrupted());
    assert_eq!(bench.ask(), None);
    assert_eq!(bench.shared.kinds(), [Kind::Fault]);
}

#[test]
fn what_is_not_modelled_or_set_up_wrongly_is_found() {
    for (cr, kind, starts) in [
        (2 << 6, Kind::NotModelled, false),
        (PFCTRL, Kind::NotModelled, false),
        (1 << 23, Kind::NotModelled, false),
        (2 << 11, Kind::Alignment, true),
    ] {
        let mut bench = Bench::new(4, 0, 0);
        bench.write(&[(CR, 0), (PAR, PERIPHERAL + 2)]);
        bench.clear();
        bench.write(&[(CR, cr | EN)]);
        assert_eq!(bench.shared.kinds(), [kind], "{cr:#x}");
        assert_eq!(bench.read(CR) & EN != 0, starts);
    }
    let bench = Bench::new(0, 0, 0);
    assert_eq!(bench.shared.kinds(), [Kind::Forbidden]);
    let bench = Bench::new(3, DMDIS, 2 << 13);
    assert_eq!(bench.shared.kinds(), [Kind::Forbidden]);
}
