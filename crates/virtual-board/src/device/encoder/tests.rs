use super::*;

const MS: u64 = 1_000_000_000;

/// Counts of a decoder that sees nothing but the levels.
#[derive(Default)]
struct Decoder {
    last: (bool, bool),
    count: i64,
    jumps: u32,
}

impl Decoder {
    fn see(&mut self, levels: (bool, bool)) {
        let place = |(a, b): (bool, bool)| (i64::from(a) ^ i64::from(b)) + 2 * i64::from(b);
        match (place(levels) - place(self.last)).rem_euclid(4) {
            1 => self.count += 1,
            3 => self.count -= 1,
            2 => self.jumps += 1,
            _ => {}
        }
        self.last = levels;
    }

    fn run(&mut self, encoder: &mut Encoder, to: Time) -> u32 {
        let mut edges = 0;
        while encoder.next() <= to {
            encoder.advance(encoder.next());
            self.see(encoder.levels());
            edges += 1;
        }
        encoder.advance(to);
        edges
    }
}

#[test]
fn edges_come_when_the_angle_meets_them() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    // One revolution in 1/8.192 s is 67.1 edges a millisecond; the first after half a count.
    let speed = TAU * 8.192;
    encoder.motion(Time(0), 0.0, speed, 0.0);
    let period = 1e12 / (8192.0 * 8.192);
    for k in 0..1000 {
        let expected = period * (f64::from(k) + 0.5);
        let found = encoder.next();
        assert!((found.0 as f64 - expected).abs() < 1000.0, "{k} {found:?}");
        encoder.advance(found);
        assert_eq!(encoder.count(), i64::from(k) + 1);
    }
}

#[test]
fn a_decoder_follows_every_motion() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    let mut decoder = Decoder::default();
    // Forward, through standstill and back, in millisecond pieces with rounded states.
    let angle = |t: f64| 3.0 * t - 4.0 * t * t + 0.3 * (20.0 * t).sin();
    let speed = |t: f64| 3.0 - 8.0 * t + 6.0 * (20.0 * t).cos();
    let mut edges = 0;
    for k in 0..1000u64 {
        let t = k as f64 * 1e-3;
        let acceleration = (speed(t + 1e-3) - speed(t)) / 1e-3;
        encoder.motion(Time(k * MS), angle(t), speed(t), acceleration);
        edges += decoder.run(&mut encoder, Time((k + 1) * MS));
        let ideal = (angle(t + 1e-3) * 8192.0 / TAU + 0.5).floor() as i64;
        assert_eq!(decoder.count, encoder.count());
        assert!((decoder.count - ideal).abs() <= 1, "{k}");
    }
    assert_eq!(decoder.jumps, 0);
    // As many edges as the way is long, but for a few at each turn and rounding.
    let way: f64 = (0..100_000)
        .map(|k| speed(f64::from(k) * 1e-5).abs() * 1e-5)
        .sum();
    let expected = way * 8192.0 / TAU;
    let more = f64::from(edges) - expected;
    assert!(more.abs() < 30.0, "{edges} {expected}");
}

#[test]
fn a_wheel_that_turns_round_between_two_edges_makes_none() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    // Up by 0.4 counts and back by 0.6: the lower edge, half a count below, is met on the way.
    let count = TAU / 8192.0;
    encoder.motion(Time(0), 0.0, 40.0 * count, -2000.0 * count);
    // x(t) = 40 t − 1000 t² = −0.5 at t = 0.02 + √(0.0004 + 0.0005) = 50 ms.
    let found = encoder.next();
    assert!((found.0 as f64 - 50e9).abs() < 1e4, "{found:?}");
    encoder.advance(found);
    assert_eq!(encoder.count(), -1);
}

#[test]
fn a_wheel_that_goes_on_as_told_makes_no_edge_twice() {
    let mut encoder = Encoder::new(EncoderConfig {
        phase: 0.0,
        ..EncoderConfig::default()
    });
    // A whole number of counts a millisecond: each piece begins at an edge, but for rounding.
    let step = 64.0 * TAU / 8192.0;
    let mut edges = 0;
    for k in 0..500u64 {
        encoder.motion(Time(k * MS), k as f64 * step, step * 1e3, 0.0);
        edges += Decoder::default().run(&mut encoder, Time((k + 1) * MS));
    }
    assert!((31_999..=32_000).contains(&edges), "{edges}");
}

#[test]
fn broken_encoders() {
    // A wheel that turns for a tenth of a second: true count and decoded one.
    let turned = |set: &dyn Fn(&mut EncoderFault)| {
        let mut encoder = Encoder::new(EncoderConfig::default());
        let mut fault = EncoderFault::default();
        set(&mut fault);
        encoder.set_fault(fault);
        encoder.motion(Time(0), 0.0, 1.0, 0.0);
        let mut decoder = Decoder::default();
        decoder.see(encoder.levels());
        decoder.run(&mut encoder, Time(100 * MS));
        (encoder.count(), decoder.count)
    };
    // It sees B alone, which leads nowhere.
    let (count, decoded) = turned(&|fault| fault.stuck_a = Some(true));
    assert!(decoded.abs() <= 2 && count > 100);
    let (count, decoded) = turned(&|fault| fault.swapped = true);
    assert_eq!(decoded, -count);
}

#[test]
fn a_glitch_is_there_and_gone() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    encoder.glitch(Line::A, Time(1000), Time::from_nanos(200));
    let mut seen = Vec::new();
    while encoder.next() != Time::NEVER {
        encoder.advance(encoder.next());
        seen.push((encoder.next().0, encoder.drives()));
    }
    let (high, low) = (Drive::High, Drive::Low);
    assert_eq!(seen, [(201_000, (high, low)), (u64::MAX, (low, low))]);
}

#[test]
fn a_corrected_angle_is_caught_up_with() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    encoder.motion(Time(MS), 5.0 * TAU / 8192.0, 0.0, 0.0);
    let mut decoder = Decoder::default();
    assert_eq!(decoder.run(&mut encoder, Time(2 * MS)), 5);
    assert_eq!((decoder.count, decoder.jumps), (5, 0));
    assert_eq!(encoder.next(), Time::NEVER);
}
