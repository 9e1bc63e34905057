//! The controller, accessed through its registers, on a bus with other nodes.

use super::*;
use crate::chip::{Bare, testing};
use crate::time::Cycles;
use crate::wire::{Fault, Id, Level, Node, VirtualNode, Wire};

/// Core cycles in 1 µs; APB1 runs at a quarter of the core clock.
const MICRO: Cycles = 168;
/// Simulation step, core cycles.
const QUANTUM: Cycles = 20 * MICRO;

const MCR: u32 = 0x00;
const MSR: u32 = 0x04;
const TSR: u32 = 0x08;
const RF0R: u32 = 0x0c;
const IER: u32 = 0x14;
const ESR: u32 = 0x18;
const BTR: u32 = 0x1c;
const RDT0R: u32 = 0x1b4;
const FMR: u32 = 0x200;

/// A board with nothing but the CAN controller.
type Board = testing::PeripheralBench<Can>;

impl Board {
    fn new() -> Self {
        let mut board = Self::around(Bare, Unit::Can1, Can::after_reset());
        board.write(&[(MCR, INRQ | ABOM)]);
        assert_eq!(board.read(MSR) & 3, INAK);
        // One filter that passes all frames to FIFO 0.
        board.write(&[(FMR, 0x2a1c_0e01), (0x20c, 1)]);
        board.write(&[(0x21c, 1), (FMR, 0x2a1c_0e00)]);
        // 42 MHz / 6 / 7 time quanta: 1 Mbit/s.
        board.write(&[(BTR, 4 << 16 | 5)]);
        board
    }

    fn request(&mut self, mailbox: u32, id: u32, data: u32) {
        let place = MAILBOXES + 16 * mailbox;
        self.write(&[(place + 4, 4), (place + 8, data), (place, id << 21 | 1)]);
    }

    fn found(&self, kind: FindingKind) -> usize {
        let kinds = self.shared.kinds();
        kinds.iter().filter(|found| **found == kind).count()
    }
}

impl Node for Board {
    fn take_action(&mut self) -> Option<(Time, Action)> {
        self.part.actions.pop_front()
    }

    fn event(&mut self, event: Event) {
        self.part.post(event, &mut self.shared);
    }
}

/// Boards and one virtual node on a bus.
struct CanBench {
    wire: Wire,
    boards: Vec<Board>,
    other: VirtualNode,
    now: Cycles,
}

impl CanBench {
    fn new(boards: usize) -> Self {
        let mut wire = Wire::new(boards + 1, Time::from_micros(20), 1);
        wire.record();
        let mut off = Settings::new(BitTiming::megabit());
        off.on = false;
        Self {
            wire,
            boards: (0..boards).map(|_| Board::new()).collect(),
            other: VirtualNode::new(off),
            now: 0,
        }
    }

    /// A bench whose boards have joined the bus; the virtual node joins if `other`.
    fn joined(boards: usize, other: bool) -> Self {
        let mut bench = Self::new(boards);
        if other {
            let on = Settings::new(BitTiming::megabit());
            bench.other = VirtualNode::new(on);
        }
        for board in &mut bench.boards {
            board.write(&[(MCR, ABOM)]);
        }
        bench.run(100);
        for board in &mut bench.boards {
            assert_eq!(board.read(MSR) & 3, 0);
        }
        bench
    }

    /// Runs to `micros` µs after the start.
    fn run(&mut self, micros: u64) {
        while self.now < micros * MICRO {
            self.now += QUANTUM;
            let mut nodes: Vec<&mut dyn Node> = Vec::new();
            for board in &mut self.boards {
                board.run(self.now);
                nodes.push(board);
            }
            nodes.push(&mut self.other);
            let until = Time::from_micros(self.now / MICRO);
            self.wire.advance(until, &mut nodes);
        }
    }

    fn board(&mut self) -> &mut Board {
        &mut self.boards[0]
    }
}

#[test]
fn controller_joins_after_eleven_recessive_bits() {
    let mut bench = CanBench::new(1);
    let dominant = Fault::Level(Some(Level::Dominant));
    bench.wire.inject(Time(0), dominant);
    bench.board().write(&[(MCR, ABOM)]);
    bench.run(10_000);
    assert_eq!(bench.board().read(MSR) & 3, INAK);
    // The return to initialisation mode does not need the bus.
    bench.board().write(&[(MCR, ABOM | INRQ)]);
    assert_eq!(bench.board().read(MSR) & 3, INAK);
    bench.board().write(&[(MCR, ABOM)]);
    let free = Time::from_micros(10_060);
    bench.wire.inject(free, Fault::Level(None));
    bench.run(10_060);
    assert_eq!(bench.board().read(MSR) & 3, INAK);
    // The controller joins after eleven recessive bits, 11 µs; the simulation step of 20 µs ends at 10 080 µs.
    bench.run(10_080);
    bench.board().run(10_080 * MICRO + 1);
    assert_eq!(bench.board().read(MSR) & 3, 0);
}

#[test]
fn frame_raises_transmit_and_receive_interrupts_at_their_cycles() {
    let mut bench = CanBench::joined(2, false);
    let begin = bench.now;
    for board in &mut bench.boards {
        board.write(&[(IER, TMEIE | FMPIE[0])]);
    }
    bench.board().request(0, 0x123, 0x0403_0201);
    assert_eq!(bench.board().read(TSR) >> 24, 0b0001_1001);
    let frame = Frame::new(Id::Standard(0x123), &[1, 2, 3, 4]);
    let mut changes = Vec::new();
    // Each board advances cycle by cycle, to find the cycle at which its interrupt line rises.
    while changes.len() < 2 {
        let quantum = bench.now;
        for cycle in quantum..quantum + QUANTUM {
            let lines = [Interrupt::Can1Tx, Interrupt::Can1Rx0];
            for (k, (board, line)) in bench.boards.iter_mut().zip(lines).enumerate() {
                let before = board.shared.is_high(line);
                board.run(cycle);
                if !before && board.shared.is_high(line) {
                    changes.push((k, cycle - begin));
                }
            }
        }
        bench.run((quantum + QUANTUM) / MICRO);
        assert!(bench.now < begin + 20 * QUANTUM);
    }
    let [(1, received), (0, sent)] = changes[..] else {
        panic!("{changes:?}");
    };
    // Shortest time from the request to the sample point of the last bit. The frame may begin up to one bit later.
    let bits = frame.bits().length() as u64;
    let earliest = (bits - 1) * MICRO + MICRO * 6 / 7;
    let later = sent.checked_sub(earliest);
    assert!(later.is_some_and(|by| by < 2 * MICRO), "{sent} {bits}");
    assert!((sent - received).abs_diff(MICRO) < MICRO / 2);
    let board = bench.board();
    assert_eq!(board.read(TSR) & 0xff, RQCP | TXOK);
    board.write(&[(TSR, RQCP)]);
    assert_eq!(board.read(TSR), 0x1c00_0000);
    assert!(!board.shared.is_high(Interrupt::Can1Tx));
    let board = &mut bench.boards[1];
    assert_eq!(board.read(RF0R), 1);
    assert_eq!(board.read(OUTPUTS), 0x123 << 21);
    assert_eq!(board.read(RDT0R), 4);
    assert_eq!(board.read(RDT0R + 4), 0x0403_0201);
    board.write(&[(RF0R, RFOM)]);
    assert_eq!(board.read(RF0R), 1 | RFOM);
    board.run(board.shared.now + 8);
    assert_eq!(board.read(RF0R), 0);
    assert!(!board.shared.is_high(Interrupt::Can1Rx0));
    assert!(board.shared.findings.list().is_empty());
}

fn order(bench: &mut CanBench) -> Vec<Id> {
    let records = bench.wire.take_records();
    records.iter().map(|r| r.frame.id()).collect()
}

#[test]
fn mailboxes_are_sent_in_order_of_identifier() {
    let mut bench = CanBench::joined(2, false);
    let board = bench.board();
    for (mailbox, id) in [(0, 0x300), (1, 0x100), (2, 0x200)] {
        board.request(mailbox, id, 0);
        board.run(board.shared.now + 10);
    }
    let status = board.read(TSR);
    assert_eq!(status >> 26 & 7, 0, "no mailbox is free");
    assert_eq!((status >> 29, status >> 24 & 3), (0b001, 0));
    // All three requests come within one bit, so the identifier decides.
    bench.run(1000);
    let expected = [0x100, 0x200, 0x300].map(Id::Standard);
    assert_eq!(order(&mut bench), expected);
}

#[test]
fn equal_identifiers_are_sent_in_order_of_mailbox_number() {
    let mut bench = CanBench::joined(2, false);
    for mailbox in [2, 1, 0] {
        bench.board().request(mailbox, 0x100, mailbox);
    }
    bench.run(1000);
    let records = bench.wire.take_records();
    let data: Vec<_> = records.iter().map(|r| r.frame.data()[0]).collect();
    assert_eq!(data, [0, 1, 2]);
}

#[test]
fn missing_acknowledgement_stops_the_error_counter_at_128() {
    let mut bench = CanBench::joined(1, false);
    let board = bench.board();
    board.write(&[(IER, ERRIE | EPVIE)]);
    board.request(0, 0x100, 0);
    bench.run(400);
    let board = bench.board();
    assert_eq!(board.read(ESR) & LEC, 3 << 4);
    assert!(!board.shared.is_high(Interrupt::Can1Sce));
    bench.run(20_000);
    let board = bench.board();
    assert_eq!(board.read(ESR), 128 << 16 | 3 << 4 | EPVF | EWGF);
    assert!(board.shared.is_high(Interrupt::Can1Sce));
    board.write(&[(MSR, ERRI)]);
    assert!(!board.shared.is_high(Interrupt::Can1Sce));
    assert_eq!(board.read(TSR) >> 26 & 7, 0b110);
    // Another node joins: the frame is acknowledged.
    let on = Settings::new(BitTiming::megabit());
    bench.other = VirtualNode::new(on);
    bench.run(20_400);
    let board = bench.board();
    assert_eq!(board.read(TSR) & 3, RQCP | TXOK);
    assert_eq!(board.read(ESR), 127 << 16 | EWGF);
}

#[test]
fn abort_frees_a_waiting_mailbox_at_once_and_a_transmitting_one_at_its_end() {
    let mut bench = CanBench::joined(1, true);
    bench.board().request(0, 0x100, 0);
    bench.board().request(1, 0x101, 0);
    bench.run(120);
    let now = bench.now;
    let board = bench.board();
    board.run(now);
    board.write(&[(TSR, ABRQ | ABRQ << 8)]);
    // Mailbox 0 is being transmitted, mailbox 1 waits.
    let status = board.read(TSR);
    assert_eq!(status & 0xff, ABRQ);
    assert_eq!(status >> 8 & 0xff, RQCP);
    bench.run(1000);
    let status = bench.board().read(TSR);
    assert_eq!(status & 0xff, RQCP | TXOK);
    assert_eq!(status >> 26 & 7, 7);
    assert_eq!(order(&mut bench), [Id::Standard(0x100)]);
    assert_eq!(bench.wire.statistics(0).given_up, 1);

    // No node acknowledges the frame, so the aborted transmission ends at its first error.
    let mut bench = CanBench::joined(1, false);
    bench.board().request(0, 0x100, 0);
    bench.run(140);
    bench.board().run(140 * MICRO);
    bench.board().write(&[(TSR, ABRQ)]);
    assert_eq!(bench.board().read(TSR) & 0xff, ABRQ);
    bench.run(400);
    assert_eq!(bench.board().read(TSR) & 0xff, RQCP | TERR);
    assert_eq!(bench.wire.take_records().len(), 1);
    assert_eq!(bench.wire.statistics(0).given_up, 1);
}

#[test]
fn bus_off_recovers_automatically_or_by_the_program() {
    for recover in [true, false] {
        let mut bench = CanBench::joined(2, false);
        let mcr = if recover { ABOM } else { 0 };
        bench.board().write(&[(MCR, mcr), (IER, ERRIE | BOFIE)]);
        // The transceiver transmits, but its receive output stays recessive.
        let transceiver = |receive_enabled| Fault::Transceiver {
            node: 0,
            transmit_enabled: true,
            receive_enabled,
        };
        let at = Time::from_micros;
        bench.wire.inject(at(200), transceiver(false));
        bench.run(240);
        bench.board().request(0, 0x100, 0);
        while bench.board().read(ESR) & BOFF == 0 {
            bench.run(bench.now / MICRO + 20);
            assert!(bench.now < 1200 * MICRO);
        }
        let mut from = bench.now / MICRO;
        let board = bench.board();
        assert_eq!(board.read(ESR) & (BOFF | LEC), BOFF | 5 << 4);
        assert!(board.shared.is_high(Interrupt::Can1Sce));
        bench.wire.inject(at(from), transceiver(true));
        if !recover {
            bench.run(10_000);
            let board = bench.board();
            assert_eq!(board.read(ESR) & BOFF, BOFF);
            board.write(&[(MCR, INRQ)]);
            bench.run(10_100);
            assert_eq!(bench.board().read(MSR) & 3, INAK);
            bench.board().write(&[(MCR, 0)]);
            // The recovery time counts from joining the bus, which takes eleven bits.
            from = bench.now / MICRO + 11;
        }
        // Recovery from bus-off takes 128 times eleven bits; the margins are a few simulation steps.
        bench.run(from + 128 * 11 - 60);
        assert_eq!(bench.board().read(ESR) & BOFF, BOFF);
        bench.run(from + 128 * 11 + 120);
        let board = bench.board();
        assert_eq!(board.read(ESR), 0);
        // The pending frame has been transmitted.
        assert_eq!(board.read(TSR) & 0xff, RQCP | TXOK);
    }
}

#[test]
fn fourth_frame_overruns_the_fifo_and_is_a_finding() {
    let mut bench = CanBench::joined(1, true);
    bench.board().write(&[(IER, FFIE[0])]);
    for id in 0..4 {
        bench.other.send(Time(0), Frame::new(Id::Standard(id), &[]));
    }
    bench.run(280);
    assert!(bench.board().shared.is_high(Interrupt::Can1Rx0));
    bench.run(1000);
    let board = bench.board();
    assert_eq!(board.read(RF0R), 3 | FULL | FOVR);
    assert_eq!(board.part.lost(), 1);
    assert_eq!(board.found(FindingKind::Lost), 1);
    board.write(&[(RF0R, FULL)]);
    assert!(!board.shared.is_high(Interrupt::Can1Rx0));
    board.write(&[(IER, FOVIE[0])]);
    assert!(board.shared.is_high(Interrupt::Can1Rx0));
    // The fourth frame replaced the third.
    for id in [0, 1, 3] {
        assert_eq!(board.read(OUTPUTS), id << 21);
        board.write(&[(RF0R, RFOM)]);
        board.run(board.shared.now + 8);
    }
    assert_eq!(board.read(RF0R), FOVR);
}

#[test]
fn forbidden_writes_are_findings_without_effect() {
    let mut bench = CanBench::joined(1, false);
    let board = bench.board();
    let btr = board.read(BTR);
    board.write(&[(BTR, 7)]);
    assert_eq!(board.read(BTR), btr);
    board.write(&[(0x204, 1)]);
    assert_eq!(board.read(0x204), 0);
    board.write(&[(BANKS, 1)]);
    assert_eq!(board.read(BANKS), 0);
    board.request(0, 0x100, 1);
    board.write(&[(MAILBOXES + 8, 2)]);
    assert_eq!(board.read(MAILBOXES + 8), 1);
    assert_eq!(board.found(FindingKind::Forbidden), 4);
    board.write(&[(MCR, ABOM | TTCM)]);
    assert_eq!(board.found(FindingKind::Forbidden), 5);
    assert_eq!(board.found(FindingKind::ClockLimit), 0);
    // Reset value of BTR: 42 MHz divided by eight.
    let mut bench = CanBench::new(1);
    let board = bench.board();
    board.write(&[(BTR, 0x0123_0000), (MCR, ABOM)]);
    bench.run(100);
    assert_eq!(bench.board().found(FindingKind::ClockLimit), 1);
}

#[test]
fn leaving_the_bus_waits_for_the_end_of_the_frame() {
    let mut bench = CanBench::joined(1, true);
    bench.board().request(0, 0x100, 0);
    bench.run(120);
    bench.board().write(&[(MCR, INRQ | ABOM)]);
    assert_eq!(bench.board().read(MSR) & 3, 0);
    bench.run(240);
    let board = bench.board();
    assert_eq!(board.read(MSR) & 3, INAK);
    assert_eq!(board.read(TSR) & 0xff, RQCP | TXOK);
}

#[test]
fn reset_aborts_a_frame_in_progress() {
    let mut bench = CanBench::joined(2, false);
    bench.board().request(0, 0x100, 0);
    bench.run(120);
    let board = bench.board();
    board.part.reset(&mut board.shared);
    bench.run(1000);
    let board = bench.board();
    assert_eq!(board.read(MSR) & 3, SLAK);
    assert_eq!(board.read(TSR), 0x1c00_0000);
    let other = bench.wire.statistics(1);
    assert_eq!((other.received, other.error_frames), (0, 1));
}

#[test]
fn enabling_an_unmodelled_feature_is_a_finding() {
    let mut bench = CanBench::new(1);
    let board = bench.board();
    for (offset, value) in [
        (BTR, SILM | 4 << 16 | 5),
        (BTR, LBKM | 4 << 16 | 5),
        (IER, WKUIE),
        (MCR, NART),
        (MCR, AWUM),
        (MCR, RFLM),
        (FMR, 0x2a1c_0e01),
        (0x20c, 0),
        (FMR, 0x2a1c_0e00),
    ] {
        board.write(&[(MCR, INRQ | ABOM), (offset, value)]);
    }
    // One finding each for BTR, IER, MCR and the filters.
    assert_eq!(board.found(FindingKind::NotModelled), 4);
}
