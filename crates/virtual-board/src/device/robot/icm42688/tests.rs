//! Tests through the SPI interface, as a driver uses the sensor.

use super::*;

const US: u64 = 1_000_000;
const MS: u64 = 1_000 * US;

/// An SPI master with its own clock: a byte takes 0.76 µs at 10.5 MHz.
struct Bus {
    sensor: Icm42688,
    at: Time,
}

impl Bus {
    fn new(config: InertialConfig) -> Self {
        Self {
            sensor: Icm42688::new(config, 1),
            at: Time(2 * MS),
        }
    }

    fn frame<const N: usize>(&mut self, bytes: [u8; N]) -> [u8; N] {
        self.sensor.select(true, self.at);
        let answer = bytes.map(|byte| {
            self.at = self.at + Time(761_905);
            self.sensor.exchange(byte, self.at)
        });
        self.sensor.select(false, self.at);
        answer
    }

    fn read(&mut self, address: u8) -> u8 {
        self.frame([address | 0x80, 0])[1]
    }

    fn write(&mut self, address: u8, value: u8) {
        self.frame([address, value]);
    }

    /// Sets the motion from now on; quantities not set by `set` are 0.
    fn moves(&mut self, set: impl Fn(&mut Motion)) {
        let mut motion = Motion::default();
        set(&mut motion);
        self.sensor.motion(self.at, motion);
    }

    fn wait(&mut self, us: u64) {
        self.at = self.at + Time(us * US);
    }

    /// Sample: accelerometer x, y, z, then gyroscope x, y, z.
    fn sample(&mut self) -> [i16; 6] {
        let mut frame = [0; 13];
        frame[0] = 0x9f;
        let answer = self.frame(frame);
        std::array::from_fn(|k| i16::from_be_bytes([answer[2 * k + 1], answer[2 * k + 2]]))
    }

    /// Configures the sensor as the axle firmware does: ±250 °/s, ±2 g, 8 kHz; filters of second order at 400 Hz and
    /// 536 Hz.
    fn set_up(&mut self) {
        for (address, value) in [
            (0x76, 1),
            (0x0c, 0x0c),
            (0x0d, 0x90),
            (0x0e, 0x80),
            (0x76, 2),
            (0x03, 0x18),
            (0x04, 0x90),
            (0x05, 0x80),
            (0x76, 0),
            (0x4d, 0x51),
            (0x4f, 0x63),
            (0x50, 0x63),
            (0x51, 0x16),
            (0x52, 0x66),
            (0x53, 0x0d),
            (0x4e, 0x0f),
        ] {
            self.write(address, value);
            self.wait(1000);
        }
        self.wait(60_000);
    }

    /// Texts of all findings.
    fn unmodelled(&self) -> Vec<&str> {
        let list = self.sensor.findings().list();
        list.iter().map(|r| r.text.as_str()).collect()
    }
}

fn noiseless() -> InertialConfig {
    InertialConfig {
        gyro_density: 0.0,
        accel_density: 0.0,
        ..InertialConfig::default()
    }
}

#[test]
fn reset_restores_reset_values_and_sets_the_status_bit() {
    let mut bus = Bus::new(noiseless());
    let values = [0x75, 0x4f, 0x51, 0x52, 0x53].map(|address| bus.read(address));
    assert_eq!(values, [0x47, 0x06, 0x16, 0x11, 0x0d]);
    // Only the first read of INT_STATUS shows the end of the reset.
    assert_eq!([bus.read(0x2d), bus.read(0x2d)], [0x10, 0]);
    assert_eq!(bus.sample(), [i16::MIN; 6]);
    bus.write(0x4f, 0x63);
    bus.write(0x11, 0x01);
    assert_eq!(bus.read(0x75), 0);
    bus.wait(1000);
    assert_eq!((bus.read(0x4f), bus.read(0x2d)), (0x06, 0x10));
    assert_eq!(bus.unmodelled(), ["a read during a reset"]);
}

#[test]
fn firmware_setup_uses_only_modelled_features_and_scales_as_in_the_data_sheet() {
    let mut bus = Bus::new(noiseless());
    bus.moves(|motion| {
        motion.rate[2] = 100f64.to_radians();
        motion.force = [0.5 * GRAVITY, 0.0, GRAVITY];
    });
    bus.set_up();
    assert_eq!(bus.unmodelled(), [""; 0]);
    // 131 LSB/(°/s), 16 384 LSB/g.
    assert_eq!(bus.sample(), [8192, 0, 16_384, 0, 0, 13_107]);
    // All registers read back.
    for (address, value) in [(0x4e, 0x0f), (0x4f, 0x63), (0x50, 0x63), (0x52, 0x66)] {
        assert_eq!(bus.read(address), value);
    }
    bus.moves(|motion| motion.rate = [-9.0, 9.0, 0.0]);
    bus.wait(20_000);
    assert_eq!(bus.sample()[3..5], [-32_766, 32_767]);
}

#[test]
fn start_up_times_and_sample_rate_match_the_configuration() {
    let config = InertialConfig {
        clock_error: -0.01,
        ..InertialConfig::default()
    };
    let mut bus = Bus::new(config);
    bus.write(0x4f, 0x66);
    bus.write(0x4e, 0x0f);
    let on = bus.at;
    for (ms, axis, runs) in [(9, 0, false), (11, 0, true), (44, 3, false), (46, 3, true)] {
        bus.at = on + Time(ms * MS);
        assert_eq!(bus.sample()[axis] != i16::MIN, runs, "{ms} ms");
    }
    // At 1 kHz minus 1 %, one second has 990 samples; each is read once.
    let mut last = bus.sample();
    let mut changes = 0;
    for k in 0..10_000 {
        bus.at = on + Time(100 * MS + k * 100 * US);
        let next = bus.sample();
        changes += u32::from(next[3..] != last[3..]);
        last = next;
    }
    assert!((989..=991).contains(&changes), "{changes}");
}

#[test]
fn noise_has_the_density_of_the_data_sheet() {
    let mut bus = Bus::new(InertialConfig::default());
    bus.set_up();
    let n = 4000;
    let mut squares = [0.0; 2];
    for _ in 0..n {
        bus.wait(5000);
        let s = bus.sample().map(f64::from);
        squares[0] += s[5] * s[5];
        squares[1] += s[0] * s[0];
    }
    // Noise bandwidth of two second-order Butterworth filters at 536 Hz and 400 Hz in series, by the trapezoidal rule
    // over |H|² = 1/((1 + (f/536)⁴)(1 + (f/400)⁴)).
    let power = |f: f64| 1.0 / ((1.0 + (f / 536.0).powi(4)) * (1.0 + (f / 400.0).powi(4)));
    let bandwidth: f64 = (0..40_000).map(|k| 0.1 * power(0.1 * f64::from(k))).sum();
    let rms = |square: f64| (square / f64::from(n)).sqrt();
    let gyro = 2.8e-3 * bandwidth.sqrt() * 131.072;
    let accel = 70e-6 * bandwidth.sqrt() * 16_384.0;
    let found = squares.map(rms);
    assert!((found[0] / gyro - 1.0).abs() < 0.05, "{found:?} {gyro}");
    assert!((found[1] / accel - 1.0).abs() < 0.05, "{found:?} {accel}");
}

#[test]
fn ramp_is_delayed_by_the_filters() {
    let mut bus = Bus::new(noiseless());
    bus.set_up();
    let from = bus.at;
    bus.moves(|motion| motion.rate_slope[2] = 100f64.to_radians());
    bus.at = from + Time(1000 * MS);
    let asked = bus.at;
    let counts = f64::from(bus.sample()[5]);
    // A second-order Butterworth filter delays slow signals by √2/ω: 0.563 ms at 400 Hz, 0.420 ms at 536 Hz. The latest
    // sample is 0 to 125 µs old.
    let delay = 2f64.sqrt() / std::f64::consts::TAU * (1.0 / 400.0 + 1.0 / 536.0);
    let age = span_s(from, asked) - counts / 131.072 / 100.0;
    // One count corresponds to 76 µs of this ramp.
    assert!(age > delay - 40e-6 && age < delay + 170e-6, "{age} {delay}");
}

/// Gyroscope samples of a ramp from 0 to 150 °/s and back, one each millisecond.
fn turn(adaptive: bool) -> Vec<i16> {
    let mut bus = Bus::new(noiseless());
    bus.set_up();
    bus.write(0x4d, if adaptive { 0x91 } else { 0x51 });
    let mut samples = Vec::new();
    for slope in [3000f64, -3000.0] {
        let from = if slope > 0.0 {
            0.0
        } else {
            150f64.to_radians()
        };
        bus.moves(|motion| {
            motion.rate[2] = from;
            motion.rate_slope[2] = slope.to_radians();
        });
        let began = bus.at;
        for ms in 1..=50 {
            bus.at = began + Time(ms * MS);
            samples.push(bus.sample()[5]);
        }
    }
    samples
}

#[test]
fn adaptive_range_stalls_the_output_near_100_degrees_per_second_unless_disabled() {
    let equal = |samples: &[i16]| samples.windows(2).filter(|w| w[0] == w[1]).count();
    let (stalled, free) = (turn(true), turn(false));
    // The ramp is 393 counts in 1 ms. A stall of 2 ms affects two samples in each direction.
    assert_eq!((equal(&stalled), equal(&free)), (2, 0));
    let differs = stalled.iter().zip(&free).filter(|(a, b)| a != b);
    let rates: Vec<_> = differs.map(|(_, b)| f64::from(*b) / 131.072).collect();
    assert!(
        rates.iter().all(|rate| (80.0..112.0).contains(rate)),
        "{rates:?}"
    );
}

#[test]
fn burst_reads_values_of_one_sample() {
    let mut bus = Bus::new(noiseless());
    bus.set_up();
    bus.moves(|motion| motion.rate_slope = [2.0; 3]);
    bus.wait(500_000);
    // During a transfer of 10 ms, 80 samples pass and none is visible.
    bus.sensor.select(true, bus.at);
    bus.sensor.exchange(0x80 | 0x25, bus.at);
    let mut bytes = [0; 6];
    for byte in &mut bytes {
        bus.wait(2000);
        *byte = bus.sensor.exchange(0, bus.at);
    }
    bus.sensor.select(false, bus.at);
    assert!(bytes[..2] == bytes[2..4] && bytes[..2] == bytes[4..]);
    let later = bus.sample();
    assert!(later[3] > i16::from_be_bytes([bytes[0], bytes[1]]) + 100);
}

#[test]
fn each_fault_has_its_effect_on_reads() {
    let mut bus = Bus::new(InertialConfig::default());
    bus.set_up();
    let with = |bus: &mut Bus, set: &dyn Fn(&mut InertialFault)| {
        let mut fault = InertialFault::default();
        set(&mut fault);
        bus.sensor.set_fault(bus.at, fault);
    };
    for level in [false, true] {
        with(&mut bus, &|fault| fault.stuck_output = Some(level));
        assert_eq!(bus.read(0x75), u8::from(level) * 0xff);
    }
    with(&mut bus, &|fault| fault.frozen = true);
    let first = bus.sample();
    bus.wait(100_000);
    assert_eq!(bus.sample(), first);
    assert_eq!(bus.read(0x2d) & 0x08, 0x08);
    with(&mut bus, &|fault| fault.no_data_ready = true);
    bus.read(0x2d);
    bus.wait(100_000);
    assert_eq!(bus.read(0x2d), 0);
    assert!(bus.sample() != first);
    // A spontaneous reset sets the bit in INT_STATUS, and the settings are lost.
    bus.sensor.reset(bus.at);
    bus.wait(1100);
    assert_eq!((bus.read(0x2d), bus.read(0x4e)), (0x10, 0));
    assert_eq!(bus.sample(), [i16::MIN; 6]);
}

#[test]
fn unmodelled_or_forbidden_use_is_a_finding() {
    let mut bus = Bus::new(noiseless());
    bus.write(0x51, 0x36);
    bus.write(0x7f, 1);
    bus.write(0x4f, 0x16);
    bus.write(0x4e, 0x0f);
    bus.write(0x50, 0x86);
    bus.wait(10_000);
    bus.write(0x4e, 0x00);
    let expected = [
        "GYRO_CONFIG1: bits 0x20 are not modelled (0x36)",
        "a write to 0x7f in bank 0",
        "GYRO_CONFIG0: reserved bits 0x10 changed",
        "ACCEL_CONFIG0 written within 200 µs of switching on",
        "accelerometer: range 4",
        "gyroscope off after 10.0 ms",
    ];
    assert_eq!(bus.unmodelled(), expected);
}
