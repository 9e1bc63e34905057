//! Five strain bridges and their excitation, 96 000 scans a second.
//!
//! A scan is six conversions of 27 cycles at 21 MHz: 7.7 µs of the 10.4 µs between scans. The sums
//! of 96 scans are the readings of a millisecond, and their arrival is the tick of the board. The
//! thermistor is converted between two scans, once a millisecond.

mod converter;

use core_algos::acquisition::analog::Thermistor;
use core_algos::acquisition::oversampling::{FULL_SCALE, ratiometric, sums};
use core_algos::beam::MAX_GAUGES;
use core_algos::time::Micros;
use embassy_stm32::Peri;
use embassy_stm32::adc::{AdcChannel, AnyAdcChannel};
use embassy_stm32::peripherals::{ADC1, DMA2_CH0, PA2, PA3, TIM2};

use converter::{CHANNELS, Converter};

/// Bridges on the strip; the excitation is the last channel of a scan.
const BRIDGES: usize = CHANNELS - 1;
/// Converter count of the nominal excitation, which equals the converter's reference and is halved before the input.
const EXCITATION: u32 = FULL_SCALE as u32 / 2;
/// Count of a missing conversion.
const MISSING: i32 = -1;

/// Pins and peripherals of the bridges.
pub struct Parts {
    /// A/D converter.
    pub adc: Peri<'static, ADC1>,
    /// DMA stream of the converter.
    pub dma: Peri<'static, DMA2_CH0>,
    /// Timer of the scans.
    pub timer: Peri<'static, TIM2>,
    /// Inputs of the bridges, in the order of the gauges from the root of the strip.
    pub bridges: [AnyAdcChannel<'static, ADC1>; BRIDGES],
    /// Input of half the excitation, as it arrives at the strip.
    pub excitation: Peri<'static, PA2>,
    /// Input of the thermistor on the strip.
    pub temperature: Peri<'static, PA3>,
}

/// Readings of a tick.
pub struct Block {
    /// Local time at the end of the last conversion.
    pub local: Micros,
    /// Counts of the bridges, 0 to [`FULL_SCALE`]; [`MISSING`] beyond the last bridge, and everywhere if the excitation
    /// is invalid.
    pub counts: [i32; MAX_GAUGES],
    /// Excitation divided by its nominal value.
    pub excitation: f32,
}

/// Sampling of the bridges.
pub struct Bridges {
    converter: Converter,
    thermistor: Thermistor,
}

impl Bridges {
    /// Starts sampling the bridges, their excitation and the thermistor.
    pub fn start(parts: Parts, thermistor: Thermistor) -> Self {
        let [a, b, c, d, e] = parts.bridges;
        let scan = [a, b, c, d, e, parts.excitation.degrade_adc()];
        let temperature: AnyAdcChannel<'_, ADC1> = parts.temperature.degrade_adc();
        let converter = Converter::start(
            parts.adc,
            parts.dma,
            parts.timer,
            scan.map(|channel| channel.get_hw_channel()),
            temperature.get_hw_channel(),
        );
        Self {
            converter,
            thermistor,
        }
    }

    /// Waits for the readings of a millisecond. `None` if conversions were lost: the assignment of samples to bridges
    /// is then unknown. Readings that are not fetched in time are skipped, and a tick is missed.
    pub async fn read(&mut self) -> Option<Block> {
        let (local, samples) = self.converter.read().await?;
        let sums = sums::<CHANNELS>(samples);
        let measured = sums[BRIDGES];
        let mut counts = [MISSING; MAX_GAUGES];
        for (count, &sum) in counts.iter_mut().zip(&sums[..BRIDGES]) {
            *count = ratiometric(sum, measured, EXCITATION).unwrap_or(MISSING);
        }
        Some(Block {
            local,
            counts,
            excitation: measured as f32 / EXCITATION as f32,
        })
    }

    /// Restarts sampling with the first bridge.
    pub fn restart(&mut self) {
        self.converter.restart();
    }

    /// Temperature of the strip, °C; `None` if the thermistor is open or short, or was not converted.
    pub fn temperature(&mut self) -> Option<f32> {
        let count = self.converter.injected()?;
        self.thermistor.read(count.into(), 4096.0)
    }

    /// Lengthens the scan periods of the next tick by `by` parts in 875; negative values shorten them.
    pub fn trim(&mut self, by: i8) {
        self.converter.trim(by);
    }
}
