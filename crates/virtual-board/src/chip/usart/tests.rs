use super::*;
use crate::chip::circuit::Circuit;
use crate::chip::testing::PeripheralBench;
use crate::time::Time;

const SR: u32 = 0x00;
const DR: u32 = 0x04;
const BRR: u32 = 0x08;
const CR1: u32 = 0x0c;
const CR2: u32 = 0x10;
const CR3: u32 = 0x14;
/// 42 MHz / 42: 1 Mbit/s; a bit is 168 core cycles.
const BIT: Cycles = 168;
const FRAME: Cycles = 10 * BIT;

#[derive(Clone, Default)]
struct Line {
    bytes: Vec<(u8, Time)>,
}

impl Circuit for Line {
    fn serial(&mut self, byte: u8, at: Time) {
        self.bytes.push((byte, at));
    }
}

/// An enabled USART at the start of its idle frame.
fn enabled(cr1: u32) -> PeripheralBench<Usart> {
    let mut bench = PeripheralBench::around(Line::default(), Unit::Usart3, Usart::after_reset());
    bench.write(&[(BRR, 42), (CR1, UE | TE | RE | cr1)]);
    bench
}

fn idle() -> PeripheralBench<Usart> {
    let mut bench = enabled(0);
    bench.run(FRAME);
    bench.shared.effects.clear();
    bench
}

fn sent(bench: &mut PeripheralBench<Usart>) -> Vec<(u8, Cycles)> {
    let base = bench.shared.base;
    let bytes = bench.circuit::<Line>().bytes.drain(..);
    bytes.map(|(byte, at)| (byte, base.cycle_of(at))).collect()
}

#[test]
fn bytes_follow_the_idle_frame_without_a_gap() {
    let mut bench = enabled(TCIE);
    bench.write(&[(DR, 0x12)]);
    assert_eq!(bench.read(SR) & (TXE | TC), 0);
    bench.run(FRAME);
    assert_eq!(bench.read(SR) & (TXE | TC), TXE);
    bench.write(&[(DR, 0x34)]);
    assert_eq!(bench.shared.lines, 0);
    bench.run(3 * FRAME - 1);
    assert_eq!(bench.read(SR) & (TXE | TC), TXE);
    bench.run(3 * FRAME);
    assert_eq!(bench.read(SR) & (TXE | TC), TXE | TC);
    assert_eq!(bench.shared.lines, 1 << Interrupt::Usart3 as u32);
    let sent = sent(&mut bench);
    assert_eq!(sent, [(0x12, 2 * FRAME), (0x34, 3 * FRAME)]);
    bench.write(&[(SR, !TC)]);
    assert_eq!(bench.shared.lines, 0);
}

#[test]
fn received_byte_is_followed_by_the_idle_flag() {
    let mut bench = idle();
    bench.write(&[(CR1, UE | TE | RE | RXNEIE | IDLEIE)]);
    bench.part.receive(0x41, &mut bench.shared);
    assert_ne!(bench.shared.lines, 0);
    assert_eq!(bench.read(DR), 0x41);
    assert_eq!(bench.shared.lines, 0);
    let end = bench.shared.now + FRAME;
    bench.run(end - 1);
    assert_eq!(bench.read(SR) & IDLE, 0);
    bench.run(end);
    assert_eq!(bench.read(SR) & IDLE, IDLE);
    assert_ne!(bench.shared.lines, 0);
    bench.read(DR);
    assert_eq!((bench.read(SR) & IDLE, bench.shared.lines), (0, 0));
}

#[test]
fn unread_byte_is_an_overrun() {
    let mut bench = idle();
    bench.part.receive(1, &mut bench.shared);
    bench.part.receive(2, &mut bench.shared);
    assert_eq!(bench.read(SR) & (RXNE | ORE), RXNE | ORE);
    assert_eq!(bench.read(DR), 1);
    assert_eq!(bench.read(SR) & (RXNE | ORE), 0);
    assert_eq!(bench.shared.kinds(), [FindingKind::Lost]);
    // With the receiver disabled, bytes are ignored.
    bench.write(&[(CR1, UE | TE)]);
    bench.part.receive(3, &mut bench.shared);
    assert_eq!(bench.read(SR) & RXNE, 0);
}

#[test]
fn dma_is_requested_in_both_directions() {
    let mut bench = idle();
    bench.write(&[(CR3, DMAT | DMAR), (DR, 1)]);
    bench.part.receive(1, &mut bench.shared);
    let expected = [Request::Usart3Tx, Request::Usart3Tx, Request::Usart3Rx];
    assert_eq!(bench.requests(), expected);
}

#[test]
fn unmodelled_features_and_misuse_are_findings() {
    let mut bench = idle();
    bench.write(&[(CR3, HDSEL), (CR2, LINEN)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::NotModelled; 2]);
    bench.write(&[(DR, 1), (BRR, 43)]);
    assert_eq!(bench.shared.kinds()[2], FindingKind::Forbidden);
    bench.write(&[(CR1, 0), (DR, 1)]);
    assert_eq!(bench.shared.kinds()[3..], [FindingKind::Forbidden; 2]);
    let mut bench = enabled(PCE | M | OVER8);
    bench.write(&[(CR2, STOP)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::NotModelled; 4]);
}
