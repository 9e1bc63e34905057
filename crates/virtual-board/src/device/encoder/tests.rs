use super::*;

const MS: u64 = 1_000_000_000;

/// A quadrature decoder that reads only the levels.
#[derive(Default)]
struct Decoder {
    last: (bool, bool),
    count: i64,
    jumps: u32,
}

impl Decoder {
    fn decode(&mut self, levels: (bool, bool)) {
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
            self.decode(encoder.levels());
            edges += 1;
        }
        encoder.advance(to);
        edges
    }
}

#[test]
fn edges_occur_when_the_angle_reaches_them() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    // A revolution in 1/8.192 s is 67.1 edges in 1 ms; the first edge is half a count away.
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
fn decoder_follows_every_motion() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    let mut decoder = Decoder::default();
    // The wheel turns forward, stops and turns backward. The motion is set anew every millisecond, with a constant
    // acceleration until then.
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
    // The number of edges matches the distance, except for a few at each reversal and for rounding.
    let way: f64 = (0..100_000)
        .map(|k| speed(f64::from(k) * 1e-5).abs() * 1e-5)
        .sum();
    let expected = way * 8192.0 / TAU;
    let more = f64::from(edges) - expected;
    assert!(more.abs() < 30.0, "{edges} {expected}");
}

#[test]
fn wheel_that_reverses_between_two_edges_makes_no_edge() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    // The wheel turns forward by 0.4 counts and then backward, so its first edge is half a count below the start.
    let count = TAU / 8192.0;
    encoder.motion(Time(0), 0.0, 40.0 * count, -2000.0 * count);
    // x(t) = 40 t − 1000 t² = −0.5 at t = 0.02 + √(0.0004 + 0.0005) = 50 ms.
    let found = encoder.next();
    assert!((found.0 as f64 - 50e9).abs() < 1e4, "{found:?}");
    encoder.advance(found);
    assert_eq!(encoder.count(), -1);
}

#[test]
fn steady_motion_in_pieces_repeats_no_edge() {
    let mut encoder = Encoder::new(EncoderConfig {
        phase: 0.0,
        ..EncoderConfig::default()
    });
    // The wheel turns by a whole number of counts in 1 ms, so each motion begins at an edge, except for rounding.
    let step = 64.0 * TAU / 8192.0;
    let mut edges = 0;
    for k in 0..500u64 {
        encoder.motion(Time(k * MS), k as f64 * step, step * 1e3, 0.0);
        edges += Decoder::default().run(&mut encoder, Time((k + 1) * MS));
    }
    assert!((31_999..=32_000).contains(&edges), "{edges}");
}

#[test]
fn stuck_line_stops_the_count_and_swapped_lines_reverse_it() {
    // True count and decoded count of a wheel that turns for 0.1 s.
    let turned = |set: &dyn Fn(&mut EncoderFault)| {
        let mut encoder = Encoder::new(EncoderConfig::default());
        let mut fault = EncoderFault::default();
        set(&mut fault);
        encoder.set_fault(fault);
        encoder.motion(Time(0), 0.0, 1.0, 0.0);
        let mut decoder = Decoder::default();
        decoder.decode(encoder.levels());
        decoder.run(&mut encoder, Time(100 * MS));
        (encoder.count(), decoder.count)
    };
    // Only B changes, so the decoder counts up and down by 1.
    let (count, decoded) = turned(&|fault| fault.stuck_a = Some(true));
    assert!(decoded.abs() <= 2 && count > 100);
    let (count, decoded) = turned(&|fault| fault.swapped = true);
    assert_eq!(decoded, -count);
}

#[test]
fn glitch_inverts_a_line_for_its_width() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    encoder.glitch(Line::A, Time(1000), Time::from_nanos(200));
    let mut drives = Vec::new();
    while encoder.next() != Time::NEVER {
        encoder.advance(encoder.next());
        drives.push((encoder.next().0, encoder.drives()));
    }
    let (high, low) = (Drive::High, Drive::Low);
    assert_eq!(drives, [(201_000, (high, low)), (u64::MAX, (low, low))]);
}

#[test]
fn corrected_angle_is_reached_by_catch_up_edges() {
    let mut encoder = Encoder::new(EncoderConfig::default());
    encoder.motion(Time(MS), 5.0 * TAU / 8192.0, 0.0, 0.0);
    let mut decoder = Decoder::default();
    assert_eq!(decoder.run(&mut encoder, Time(2 * MS)), 5);
    assert_eq!((decoder.count, decoder.jumps), (5, 0));
    assert_eq!(encoder.next(), Time::NEVER);
}
