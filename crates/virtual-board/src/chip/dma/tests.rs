use super::*;
use crate::chip::testing::shared;

const PERIPHERAL: u32 = 0x4001_204c;
const FIRST: u32 = 0x2000_0100;
/// Widths of peripheral and memory: halfwords.
const HALVES: u32 = 1 << 11 | 1 << 13;

// Registers of stream 0.
const CR: u32 = 0x10;
const NDTR: u32 = 0x14;
const PAR: u32 = 0x18;
const M0AR: u32 = 0x1c;
const FCR: u32 = 0x24;

/// Stream 0 of DMA2 with ADC1 on channel 0.
struct DmaBench {
    dma: Dma,
    shared: Shared,
    broken: bool,
}

impl DmaBench {
    fn new(items: u32, fcr: u32, cr: u32) -> Self {
        let mut bench = Self {
            dma: Dma::new(Controller::Dma2),
            shared: shared(),
            broken: false,
        };
        bench.write(&[(NDTR, items), (PAR, PERIPHERAL), (M0AR, FIRST)]);
        bench.write(&[(FCR, fcr), (CR, cr), (CR, cr | EN)]);
        bench
    }

    fn write(&mut self, values: &[(u32, u32)]) {
        for &(offset, value) in values {
            self.dma.write(offset, value, !0, &mut self.shared);
        }
    }

    fn read(&mut self, offset: u32) -> u32 {
        self.dma.read(offset, &mut self.shared)
    }

    /// Serves a request of ADC1: the item moved and true if a block ended; `None` if no stream is assigned.
    fn request(&mut self) -> Option<((u32, u32, Width), bool)> {
        let stream = self.dma.assigned_stream(Request::Adc1)?;
        let item = self.dma.item(stream);
        let ended = self.dma.moved(stream, !self.broken, &mut self.shared);
        Some((item, ended))
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
fn circular_stream_flags_half_and_full_transfer() {
    let mut bench = DmaBench::new(4, 0, HTIE | TCIE | CIRC | MINC | HALVES);
    let mut transfers = Vec::new();
    for _ in 0..6 {
        let ((from, place, width), ended) = bench.request().unwrap();
        assert_eq!((from, width), (PERIPHERAL, Width::Half));
        let flags = bench.flags();
        assert_eq!(bench.interrupted(), flags != 0);
        transfers.push((place - FIRST, flags, ended, bench.read(NDTR)));
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
    assert_eq!(transfers, expected);
    assert!(bench.dma.assigned_stream(Request::Usart3Rx).is_none());
}

#[test]
fn single_block_moves_in_both_directions_and_ends() {
    for direction in [0, TO_PERIPHERAL] {
        let mut bench = DmaBench::new(2, 0, direction | MINC | HALVES);
        for (memory, ends) in [(FIRST, false), (FIRST + 2, true)] {
            let (from, to) = match direction {
                0 => (PERIPHERAL, memory),
                _ => (memory, PERIPHERAL),
            };
            assert_eq!(bench.request(), Some(((from, to, Width::Half), ends)));
        }
        assert_eq!(bench.request(), None);
        assert_eq!((bench.read(CR) & EN, bench.read(NDTR)), (0, 0));
        assert_eq!(bench.flags(), HTIF | TCIF);
        assert!(!bench.interrupted());
    }
}

#[test]
fn requests_are_routed_to_the_streams_of_the_manual() {
    // RM0090, tables of the request mapping: controller, stream, channel.
    for (controller, stream, channel, request) in [
        (Controller::Dma2, 4, 0, Request::Adc1),
        (Controller::Dma1, 1, 4, Request::Usart3Rx),
        (Controller::Dma1, 4, 7, Request::Usart3Tx),
    ] {
        let (mut dma, mut shared) = (Dma::new(controller), shared());
        let base = 0x18 * stream as u32;
        dma.write(base + NDTR, 1, !0, &mut shared);
        dma.write(base + CR, channel << 25 | EN, !0, &mut shared);
        assert_eq!(dma.assigned_stream(request), Some(stream));
        dma.write(base + CR, 0, !0, &mut shared);
        assert_eq!(dma.assigned_stream(request), None);
    }
}

#[test]
fn running_stream_rejects_setup_and_stops_when_disabled() {
    let mut bench = DmaBench::new(4, 0, CIRC | MINC | HALVES);
    for (offset, value) in [(NDTR, 9), (PAR, 0), (M0AR, 0), (FCR, 4), (CR, EN)] {
        let before = bench.read(offset);
        bench.write(&[(offset, value)]);
        assert_eq!(bench.read(offset), before);
    }
    assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden]);
    bench.request();
    let cr = bench.read(CR);
    bench.write(&[(CR, cr & !EN)]);
    assert_eq!((bench.flags(), bench.read(NDTR)), (TCIF, 3));
    assert_eq!(bench.request(), None);
}

#[test]
fn stream_with_flags_set_does_not_start() {
    let mut bench = DmaBench::new(4, 0, MINC | HALVES);
    let cr = bench.read(CR);
    bench.write(&[(CR, cr & !EN), (CR, cr)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden]);
    assert_eq!(bench.read(CR) & EN, 0);
    bench.clear();
    bench.write(&[(CR, cr)]);
    assert_eq!(bench.read(CR) & EN, EN);
    assert_eq!(bench.request().unwrap().0.1, FIRST);
}

#[test]
fn bus_error_stops_the_stream() {
    let mut bench = DmaBench::new(4, 0, TEIE | CIRC | MINC | HALVES);
    bench.broken = true;
    assert!(!bench.request().unwrap().1);
    assert_eq!((bench.flags(), bench.read(CR) & EN), (TEIF, 0));
    assert!(bench.interrupted());
    assert_eq!(bench.request(), None);
    assert_eq!(bench.shared.kinds(), [FindingKind::Fault]);
}

#[test]
fn unmodelled_or_wrong_setup_of_a_stream_is_a_finding() {
    for (cr, kind, starts) in [
        (2 << 6, FindingKind::NotModelled, false),
        (PFCTRL, FindingKind::NotModelled, false),
        (1 << 23, FindingKind::NotModelled, false),
        (DBM, FindingKind::NotModelled, false),
        (PINC, FindingKind::NotModelled, false),
        (2 << 11, FindingKind::Alignment, true),
    ] {
        let mut bench = DmaBench::new(4, 0, 0);
        bench.write(&[(CR, 0), (PAR, PERIPHERAL + 2)]);
        bench.clear();
        bench.write(&[(CR, cr | EN)]);
        assert_eq!(bench.shared.kinds(), [kind], "{cr:#x}");
        assert_eq!(bench.read(CR) & EN != 0, starts);
    }
    let bench = DmaBench::new(0, 0, 0);
    assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden]);
    let bench = DmaBench::new(4, DMDIS, 0);
    assert_eq!(bench.shared.kinds(), [FindingKind::NotModelled]);
}
