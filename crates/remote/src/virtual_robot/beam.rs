//! Circuit of the beam board: the parts wired to it, by docs/wiring.md.

use super::power::{BATTERY_V, Power};
use crate::serial_line::SerialLine;
use core_algos::topology::FrameId;
use host_sim::world::drawn::Drawn;
use host_sim::world::random::{Stream, generator, normal};
use host_sim::world::sensors::{BridgeConfig, GaugeAgeing};
use rand_pcg::Pcg64;
use virtual_board::Time;
use virtual_board::chip::{Circuit, Drive, Inputs, Net, Pin};
use virtual_board::device::{Bridge, BridgeConfig as DeviceConfig, Thermistor, olimex_h405};

/// Pins of the strain bridges, counted from the root of the strip.
const BRIDGES: [Pin; 5] = [
    Pin::new('C', 0),
    Pin::new('C', 1),
    Pin::new('C', 2),
    Pin::new('C', 3),
    Pin::new('A', 1),
];
const EXCITATION: Pin = Pin::new('A', 2);
const TEMPERATURE: Pin = Pin::new('A', 3);

/// Supply of chip, bridges and amplifiers, V.
const LOGIC_V: f64 = 3.3;
/// Temperature of the strip, °C.
const AMBIENT_C: f64 = 25.0;
/// Conversions of a bridge per millisecond.
const SCANS: f64 = core_algos::acquisition::oversampling::SCANS as f64;
/// Time between two steps of the bridges' drift, ms.
const DRIFT_MS: u32 = 100;

/// Properties of one bridge that differ from beam to beam.
#[derive(Clone, Copy, Debug, Default)]
pub struct BridgeParts {
    /// Relative error of the bridge's gain.
    pub gain_error: f64,
    /// Unbalance at the time of zeroing, strain.
    pub offset: f64,
    /// Drift of the bridge since zeroing, strain.
    pub drift: f64,
    /// Zero shift of the bridge per kelvin, strain.
    pub zero_per_k: f64,
    /// Creep of the gauges minus its mean, as a share of the strain.
    pub creep_error: f64,
}

impl BridgeParts {
    /// Properties of bridge `k` of a frame, as drawn for the trial.
    pub fn of(drawn: &Drawn, frame: FrameId, k: usize) -> Self {
        let frame = &drawn.frames[frame.index()];
        Self {
            gain_error: frame.bridge_gain_error[k],
            offset: frame.bridge_offset[k],
            drift: frame.bridge_drift[k],
            zero_per_k: frame.bridge_zero_per_k[k],
            creep_error: drawn.gauge_creep_error,
        }
    }
}

/// Strain bridge whose zero drifts and whose gauges age.
#[derive(Clone)]
struct Drifting {
    bridge: Bridge,
    random: Pcg64,
    drift: f64,
    ageing: GaugeAgeing,
    last: f64,
}

/// Circuit around the beam board: strain bridges, thermistor, supplies.
#[derive(Clone)]
pub struct BeamBoard {
    bridges: Vec<Drifting>,
    thermistor: Thermistor,
    pub(super) power: Power,
    pub(super) serial: SerialLine,
    /// Fraction of the excitation that reaches the strip.
    pub(super) excitation: f64,
    walk: f64,
    countdown: u32,
}

/// Configuration of the simulated bridge device from the world's bridge parameters and the bridge's errors.
fn device(config: &BridgeConfig, parts: &BridgeParts) -> DeviceConfig {
    let factor = config.gauge_factor * f64::from(config.active_gauges) / 4.0;
    DeviceConfig {
        gauge_factor: factor,
        gain: config.amplifier_gain,
        gain_error: parts.gain_error,
        offset_strain: parts.offset,
        bandwidth_hz: config.bandwidth_hz,
        noise_v: config.noise_strain * SCANS.sqrt() * factor * config.amplifier_gain * LOGIC_V,
        ..DeviceConfig::default()
    }
}

/// Reading of a bridge on a straight strip at the time of zeroing, fraction of the converter's range.
pub fn zero(config: &BridgeConfig, parts: &BridgeParts) -> f64 {
    let config = DeviceConfig {
        noise_v: 0.0,
        ..device(config, parts)
    };
    Bridge::new(config, LOGIC_V, 1).sample(Time(0)) / LOGIC_V
}

impl BeamBoard {
    /// Circuit of a beam board on a straight strip.
    pub fn new(
        config: &BridgeConfig,
        parts: &[BridgeParts],
        frame: FrameId,
        (seed, trial): (u64, u64),
    ) -> Self {
        let bridge = |(k, parts): (usize, &BridgeParts)| {
            let (frame, k) = (frame.index() as u64, k as u64);
            let stream = Stream::Other(0x100 + 0x10 * frame + k);
            let noise = seed ^ (trial << 16) ^ k ^ (frame << 40);
            Drifting {
                bridge: Bridge::new(device(config, parts), LOGIC_V, noise),
                random: generator(seed, trial, stream),
                drift: parts.drift,
                ageing: GaugeAgeing::new(config, parts.zero_per_k, parts.creep_error),
                last: 0.0,
            }
        };
        let step = (f64::from(DRIFT_MS) * 1e-3).sqrt();
        Self {
            bridges: parts
                .iter()
                .take(BRIDGES.len())
                .enumerate()
                .map(bridge)
                .collect(),
            thermistor: Thermistor::default(),
            power: Power::new(BATTERY_V),
            serial: SerialLine::default(),
            excitation: 1.0,
            walk: config.drift_walk_strain * step,
            countdown: DRIFT_MS,
        }
    }

    /// Bridge at index `place`, counted from the root.
    pub fn bridge(&mut self, place: usize) -> Option<&mut Bridge> {
        let drifting = self.bridges.get_mut(place)?;
        Some(&mut drifting.bridge)
    }

    /// Sets the fraction of the excitation that reaches the strip from `at` on.
    pub fn excite(&mut self, at: Time, share: f64) {
        self.excitation = share;
        for drifting in &mut self.bridges {
            drifting.bridge.feed(at, share * LOGIC_V, LOGIC_V);
        }
    }

    /// Sets the true strains at `at`. Call this function once per millisecond; between two calls each strain continues
    /// with its latest slope. On return, `strains` includes creep, thermal effects and drift of the gauges.
    pub fn strain(&mut self, at: Time, strains: &mut [f64]) {
        self.countdown -= 1;
        let step = self.countdown == 0;
        if step {
            self.countdown = DRIFT_MS;
        }
        for (drifting, strain) in self.bridges.iter_mut().zip(strains) {
            if step {
                drifting.drift += normal(&mut drifting.random, self.walk);
            }
            let slope = (*strain - drifting.last) * 1e3;
            drifting.last = *strain;
            let [held, moved] = drifting.ageing.next(*strain);
            *strain = held + (drifting.drift + moved);
            drifting.bridge.strain(at, *strain, slope);
        }
    }
}

impl Circuit for BeamBoard {
    fn nets(&self) -> &'static [Net] {
        olimex_h405::NETS
    }

    fn pin(&mut self, _pin: Pin, _drive: Drive, _at: Time) {}

    fn voltage(&mut self, pin: Pin, at: Time) -> f64 {
        let bridges = BRIDGES.iter().zip(&mut self.bridges);
        for (place, drifting) in bridges {
            if *place == pin {
                return drifting.bridge.sample(at);
            }
        }
        match pin {
            EXCITATION => 0.5 * LOGIC_V * self.excitation,
            TEMPERATURE => self.thermistor.voltage(AMBIENT_C, LOGIC_V),
            _ => 0.0,
        }
    }

    fn spi(&mut self, _word: u16, _bits: u32, _at: Time) -> u16 {
        !0
    }

    fn supply(&mut self, at: Time) -> f64 {
        self.power.logic_v(at)
    }

    fn serial(&mut self, byte: u8, _at: Time) {
        self.serial.sent.push(byte);
    }

    fn next(&self) -> Time {
        self.power.next().min(self.serial.next())
    }

    fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        self.serial.advance(at, inputs);
        self.power.advance(at, inputs);
    }
}
