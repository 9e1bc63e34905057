//! Five strain bridges and their excitation: ADC1, 96 000 scans a second by TIM2, DMA.
//!
//! A scan is six conversions of 27 cycles at 21 MHz: 7.7 µs of the 10.4 µs between scans. The sums
//! of 96 scans are the readings of a millisecond, and their arrival is the tick of the board. The
//! thermistor is an injected conversion, once in a while, between the others.

use core_algos::acquisition::analog::Thermistor;
use core_algos::acquisition::oversampling::{FULL_SCALE, SCANS, ratiometric, sums};
use core_algos::beam::MAX_GAUGES;
use core_algos::node::Micros;
use embassy_stm32::adc::{
    Adc, AdcChannel, AnyAdcChannel, Exten, InjectedAdc, RingBufferedAdc, SampleTime,
};
use embassy_stm32::pac::timer::vals::Mms;
use embassy_stm32::pac::{ADC1 as ADC1_REGISTERS, TIM2};
use embassy_stm32::peripherals::{ADC1, DMA2_CH0, PA2, PA3};
use embassy_stm32::{Peri, bind_interrupts, dma, peripherals, rcc, triggers};
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::ConstStaticCell;

bind_interrupts!(struct Irqs {
    DMA2_STREAM0 => dma::InterruptHandler<DMA2_CH0>;
});

/// Bridges on the strip.
const BRIDGES: usize = 5;
/// Channels of a scan: the bridges, then the excitation.
const CHANNELS: usize = BRIDGES + 1;
/// Conversions of a tick.
const BLOCK: usize = SCANS * CHANNELS;
/// Top of the timer: 84 MHz / 875 = 96 kHz.
const TOP: u32 = 874;
/// The excitation comes back from the strip halved, and is the converter's own reference.
const EXCITATION: u32 = FULL_SCALE as u32 / 2;
/// Time without samples after which the stream has stopped.
const PATIENCE: Duration = Duration::from_millis(3);
/// A count that says "no conversion".
const MISSING: i32 = -1;

/// Pins and peripherals of the bridges.
pub struct Parts {
    /// Converter.
    pub adc: Peri<'static, ADC1>,
    /// Its stream.
    pub dma: Peri<'static, DMA2_CH0>,
    /// Timer of the scans.
    pub timer: Peri<'static, peripherals::TIM2>,
    /// Bridges, from the root of the strip.
    pub bridges: [AnyAdcChannel<'static, ADC1>; BRIDGES],
    /// Half the excitation, as it arrives at the strip.
    pub excitation: Peri<'static, PA2>,
    /// Thermistor on the strip.
    pub temperature: Peri<'static, PA3>,
}

/// Readings of a tick.
pub struct Block {
    /// Local time at which the last conversion was there.
    pub local: Micros,
    /// Counts of the bridges, 0 to [`FULL_SCALE`]; all [`MISSING`] if the excitation is not sound.
    pub counts: [i32; MAX_GAUGES],
    /// Excitation over its nominal value.
    pub excitation: f32,
}

/// The bridges.
pub struct Bridges {
    adc: RingBufferedAdc<'static, ADC1>,
    injected: InjectedAdc<'static, ADC1, 1>,
    samples: &'static mut [u16; BLOCK],
    thermistor: Thermistor,
}

impl Bridges {
    /// Starts sampling.
    pub fn start(parts: Parts, thermistor: Thermistor) -> Self {
        static RING: ConstStaticCell<[u16; 2 * BLOCK]> = ConstStaticCell::new([0; 2 * BLOCK]);
        static SAMPLES: ConstStaticCell<[u16; BLOCK]> = ConstStaticCell::new([0; BLOCK]);
        prepare_timer(parts.timer);
        let excitation = parts.excitation.degrade_adc();
        let [a, b, c, d, e] = parts.bridges;
        let regular = [a, b, c, d, e, excitation].map(|channel| (channel, SampleTime::CYCLES15));
        let (mut adc, injected) = Adc::new(parts.adc).into_ring_buffered_and_injected(
            parts.dma,
            RING.take(),
            Irqs,
            regular.into_iter(),
            triggers::TIM2_TRGO,
            Exten::RISING_EDGE,
            [(parts.temperature.degrade_adc(), SampleTime::CYCLES28)],
            // Started by software: the edge is disabled and the trigger means nothing.
            triggers::TIM1_TRGO,
            Exten::DISABLED,
            false,
        );
        // The stream must run before the first scan: samples it does not fetch are lost for good.
        adc.start();
        TIM2.cr1().modify(|w| w.set_cen(true));
        Self {
            adc,
            injected,
            samples: SAMPLES.take(),
            thermistor,
        }
    }

    /// Waits for the readings of a millisecond; `None` if conversions were lost, after which nobody
    /// knows which sample is of which bridge. A converter that lost one stops asking for its stream, so
    /// a stream that stands still is the same.
    pub async fn read(&mut self) -> Option<Block> {
        let read = with_timeout(PATIENCE, self.adc.read(self.samples));
        read.await.ok()?.ok()?;
        let local = Instant::now().as_micros();
        let sums = sums::<CHANNELS>(self.samples);
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

    /// Begins sampling anew, with the first bridge.
    pub fn restart(&mut self) {
        TIM2.cr1().modify(|w| w.set_cen(false));
        self.adc.stop();
        // Switched off, the converter forgets where in its scan it was; the flag of the lost conversion
        // and the stream's request are cleared before it may ask again.
        ADC1_REGISTERS.cr2().modify(|w| {
            w.set_adon(false);
            w.set_dma(false);
        });
        ADC1_REGISTERS.sr().modify(|w| w.set_ovr(false));
        ADC1_REGISTERS.cr2().modify(|w| w.set_adon(true));
        self.adc.clear();
        self.adc.start();
        TIM2.cr1().modify(|w| w.set_cen(true));
    }

    /// Temperature of the strip at the last call, °C, and the beginning of a new conversion; `None`
    /// if the thermistor is open or short.
    pub fn temperature(&mut self) -> Option<f32> {
        let [count] = self.injected.read_injected_samples();
        self.injected.start_injected_conversions();
        self.thermistor.read(count.into(), 4096.0)
    }

    /// Makes the scans of the next tick closer or wider by so many parts in 875.
    pub fn trim(&mut self, by: i8) {
        TIM2.arr().write_value(TOP.wrapping_add_signed(by.into()));
    }
}

/// The timer, still stopped. Its reset gives a trigger, which must come before the converter listens.
fn prepare_timer(_timer: Peri<'static, peripherals::TIM2>) {
    rcc::enable_and_reset::<peripherals::TIM2>();
    TIM2.arr().write_value(TOP);
    TIM2.cr2().write(|w| w.set_mms(Mms::UPDATE));
    TIM2.egr().write(|w| w.set_ug(true));
    TIM2.cr1().write(|w| w.set_arpe(true));
}
