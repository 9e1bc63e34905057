use super::*;
use crate::fusion::testing::Random;

/// A board with a crystal of its own, in true time (µs, double precision).
struct Board {
    ticks: TickSync,
    /// Local time is `offset + (1 + rate) t`.
    offset: f64,
    rate: f64,
    /// True time of the next tick.
    next: f64,
    ran: Option<(Micros, f64)>,
}

impl Board {
    fn new(ticks: TickSync, offset: f64, rate: f64, phase: f64) -> Self {
        Self {
            ticks,
            offset,
            rate,
            next: phase,
            ran: None,
        }
    }

    fn local(&self, time: f64) -> Micros {
        (self.offset + (1.0 + self.rate) * time) as Micros
    }

    /// Runs one tick; the timer's period is trimmed by parts in 4200.
    fn tick(&mut self) -> TickStep {
        let step = self.ticks.step(self.local(self.next));
        if let TickStep::Run(now) | TickStep::Restart(now) = step {
            self.ran = Some((now, self.next));
            assert_eq!(self.ticks.last(), Some(now));
        }
        let period = 1000.0 * (1.0 + f64::from(self.ticks.trim()) / 4200.0);
        self.next += period / (1.0 + self.rate);
        step
    }
}

/// Sends the message of the front board, if one is due, over the bus to the rear board.
fn exchange(front: &mut Board, rear: &mut Board, sent: &mut Option<Micros>, random: &mut Random) {
    let Some((now, time)) = front.ran else {
        return;
    };
    let Some(message) = front.ticks.sync(now, sent.take()) else {
        return;
    };
    let end = time + 130.0 + 150.0 * random.uniform();
    *sent = Some(front.local(end + 2.0 * random.uniform()));
    let arrived = rear.local(end + 2.0 * random.uniform());
    rear.ticks.receive(arrived, &message);
}

/// Runs both boards up to a true time, µs. Returns the number of rear steps: wait, run, restart.
fn run(front: &mut Board, rear: &mut Board, until: f64, talk: bool) -> [u32; 3] {
    let (mut random, mut sent, mut counts) = (Random::new(8), None, [0; 3]);
    while front.next < until || rear.next < until {
        if front.next <= rear.next {
            front.tick();
            if talk {
                exchange(front, rear, &mut sent, &mut random);
            }
        } else {
            counts[match rear.tick() {
                TickStep::Wait => 0,
                TickStep::Run(_) => 1,
                TickStep::Restart(_) => 2,
            }] += 1;
        }
    }
    counts
}

#[test]
fn two_boards_run_the_same_milliseconds_at_the_same_time() {
    for (rate, phase) in [(4e-5, 437.0), (-4e-5, 912.0)] {
        let mut front = Board::new(TickSync::leading(), 350.0, 2e-5, 0.0);
        let mut rear = Board::new(TickSync::following(), 7.7e6, rate, phase);
        // The front board first brings its own ticks into step, by 0.24 µs per tick.
        run(&mut front, &mut rear, 20e6, true);
        let counts_of = |board: &Board| (board.ticks.missed(), board.ticks.restarts());
        let before = counts_of(&rear);
        let mut worst = 0.0f64;
        for second in 20..40 {
            let counts = run(&mut front, &mut rear, f64::from(second) * 1e6 + 1e6, true);
            assert_eq!([counts[0], counts[2]], [0, 0]);
            let ((a, at), (b, bt)) = (front.ran.unwrap(), rear.ran.unwrap());
            let apart = (at - bt) - (a as f64 - b as f64) / (1.0 + 2e-5);
            worst = worst.max(apart.abs());
        }
        println!("ticks apart by at most {worst:.1} µs");
        assert!(worst < 5.0, "{worst}");
        assert_eq!([counts_of(&rear), counts_of(&front)], [before, (0, 0)]);
    }
}

#[test]
fn without_the_front_board_the_others_stop_running() {
    let mut front = Board::new(TickSync::leading(), 0.0, 0.0, 0.0);
    let mut rear = Board::new(TickSync::following(), 1e6, 3e-5, 200.0);
    run(&mut front, &mut rear, 10e6, true);
    assert!(rear.ticks.in_step());
    let counts = run(&mut front, &mut rear, 12e6, false);
    // The common time is lost after a second.
    assert!((950..=1050).contains(&counts[0]), "{counts:?}");
    assert_eq!((counts[2], rear.ticks.in_step()), (0, false));
}

#[test]
fn restarted_front_board_restarts_the_others_once() {
    let mut front = Board::new(TickSync::leading(), 0.0, 0.0, 0.0);
    let mut rear = Board::new(TickSync::following(), 1e6, 3e-5, 200.0);
    run(&mut front, &mut rear, 10e6, true);
    let mut again = Board::new(TickSync::leading(), -10e6, 0.0, 10e6);
    let counts = run(&mut again, &mut rear, 20e6, true);
    assert_eq!(counts[2], 1, "{counts:?}");
    let ((a, at), (b, bt)) = (again.ran.unwrap(), rear.ran.unwrap());
    assert!((at - bt - (a as f64 - b as f64)).abs() < 5.0);
}

#[test]
fn gaps_are_counted_and_long_ones_restart() {
    let mut ticks = TickSync::leading();
    assert_eq!(ticks.step(10_000), TickStep::Run(10_000));
    assert_eq!(ticks.step(11_002), TickStep::Run(11_000));
    assert_eq!(ticks.conditions(), Conditions::NONE);
    assert_eq!(ticks.trim(), -1);
    assert_eq!(ticks.step(13_998), TickStep::Run(14_000));
    assert_eq!((ticks.trim(), ticks.missed()), (1, 2));
    assert!(ticks.conditions().contains(Condition::TickLate));
    assert_eq!(ticks.step(20_000), TickStep::Restart(20_000));
    // No millisecond runs twice.
    assert_eq!(ticks.step(20_040), TickStep::Restart(20_000));
    let stepped = Conditions::only(Condition::ClockStepped);
    assert_eq!(ticks.conditions(), stepped);
    assert_eq!(ticks.step(21_450), TickStep::Wait);
    assert_eq!(ticks.step(5_000), TickStep::Restart(5_000));
    assert_eq!(ticks.restarts(), 3);
}

fn sync(epoch: u32, last_delay_us: Option<u16>) -> Message {
    Message::TimeSync {
        epoch,
        last_delay_us,
    }
}

#[test]
fn sent_delay_is_that_of_the_epoch_before() {
    let mut ticks = TickSync::leading();
    let sync = |epoch, last_delay_us| Some(sync(epoch, last_delay_us));
    assert_eq!(ticks.sync(10_000, None), sync(1, None));
    assert_eq!(ticks.sync(11_000, None), None);
    assert_eq!(ticks.sync(20_000, Some(10_130)), sync(2, Some(130)));
    assert_eq!(ticks.sync(30_000, None), sync(3, None));
    // No delay is sent after a skipped epoch, and none for a time stamp before the epoch.
    assert_eq!(ticks.sync(50_000, Some(30_100)), sync(5, None));
    assert_eq!(ticks.sync(60_000, Some(49_000)), sync(6, None));
    assert_eq!(TickSync::following().sync(10_000, None), None);
}

/// A clock that approaches the common time with a jitter around the bound misses no tick on its way.
#[test]
fn board_coming_into_step_misses_no_tick() {
    let mut ticks = TickSync::following();
    // The common time is the local time. Ticks are late by an error that falls from 0.2 ms, with jitter.
    let mut random = Random::new(5);
    let mut runs = 0;
    for k in 1..2_000u64 {
        let error = 200.0 * (-(k as f64) / 400.0).exp() + 8.0 * random.normal();
        let local = (k * TICK).saturating_add_signed(error as i64);
        if k % 10 == 0 {
            ticks.receive(k * TICK + 100, &sync((k / 10) as u32, Some(100)));
        }
        runs += u32::from(ticks.step(local) != TickStep::Wait);
    }
    assert!(runs > 1_000, "{runs}");
    assert_eq!(ticks.missed(), 0);
}

/// Up to 5 ms between two ticks are passed over and reported. A longer gap or a step back is a restart.
#[test]
fn missed_ticks_are_passed_over_up_to_5_ms() {
    let late = Conditions::only(Condition::TickLate).with(Condition::TickOverrun, true);
    let stepped = Conditions::only(Condition::ClockStepped);
    for (ms, restart, conditions, missed) in [
        (1, false, Conditions::NONE, 0),
        (2, false, late, 1),
        (5, false, late, 4),
        (6, true, stepped, 0),
        (0, true, stepped, 0),
    ] {
        let mut ticks = TickSync::leading();
        let first = ticks.step(10 * TICK);
        assert_eq!(first, TickStep::Run(10 * TICK));
        let now = (10 + ms) * TICK;
        let expected = if restart {
            TickStep::Restart(now)
        } else {
            TickStep::Run(now)
        };
        assert_eq!(ticks.step(now), expected, "{ms}");
        assert_eq!(
            (ticks.conditions(), ticks.missed()),
            (conditions, missed),
            "{ms}"
        );
        assert_eq!(ticks.restarts(), u16::from(restart), "{ms}");
        ticks.step(now + TICK);
        assert_eq!(ticks.conditions(), Conditions::NONE);
    }
}

#[test]
fn delay_of_a_whole_epoch_is_not_sent() {
    for (delay, expected) in [(9_999, Some(9_999)), (10_000, None)] {
        let mut ticks = TickSync::leading();
        ticks.step(0);
        ticks.sync(0, None);
        let message = ticks.sync(EPOCH, Some(delay));
        let found = message.map(|message| match message {
            Message::TimeSync { last_delay_us, .. } => last_delay_us,
            _ => panic!("{message:?}"),
        });
        assert_eq!(found, Some(expected));
    }
}
