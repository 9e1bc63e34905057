//! The converter's registers: scans of ADC1 triggered by TIM2, fetched by DMA2 stream 0 (RM0090, chapters 13, 18 and
//! 10).
//!
//! The HAL's ring-buffered converter is not used: it does not report when a block was full, and does not check the
//! converter's overrun.
//!
//! TIM2's update starts a scan. The stream fetches each conversion into a circular buffer of two blocks. At the end of
//! each block, the stream's handler stamps the block and starts the injected conversion, which takes 1.3 µs; the next
//! scan begins after 2.7 µs. A late handler omits the injected conversion, which would interrupt the scan and could
//! delay the end of the scan beyond the next trigger.
//!
//! After an overrun (a result is not fetched in time) the converter makes no more DMA requests, and a stream stops
//! after an error. Both appear as missing samples. Everything is then stopped and set up as at the start, because only
//! there scan and buffer begin together.
//!
//! Of the errata (ES0182) one applies: the sequence must not be changed while it runs. It is written once, with the
//! converter off. The corruption of DMA2's data occurs only with a second stream.

use core::sync::atomic::{AtomicU16, AtomicU32, Ordering, compiler_fence};

use core_algos::acquisition::oversampling::SCANS;
use core_algos::time::{Micros, TICK};
use embassy_stm32::adc::SampleTime;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::adc::regs::Sr;
use embassy_stm32::pac::adc::vals::{Dds, Exten};
use embassy_stm32::pac::adccommon::vals::Adcpre;
use embassy_stm32::pac::dma::vals::{Pl, Size};
use embassy_stm32::pac::timer::vals::Mms;
use embassy_stm32::pac::{self, DMA2};
use embassy_stm32::peripherals::{ADC1, DMA2_CH0, TIM2};
use embassy_stm32::{Peri, interrupt, interrupt as handler, rcc};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, with_timeout};
use firmware_common::clock::CORE_HZ;
use firmware_common::critical;
use firmware_common::dma_halves::{self, Half};
use static_cell::ConstStaticCell;

/// Channels of a scan.
pub const CHANNELS: usize = 6;
/// Conversions of a block.
pub const BLOCK: usize = SCANS * CHANNELS;

/// Clock of TIM2, counts per microsecond.
const COUNTS_PER_US: u32 = CORE_HZ / 2 / 1_000_000;
/// Top of the timer: 84 MHz / 875 = 96 kHz.
const TOP: u32 = 874;
/// Code of TIM2's trigger output among the converter's triggers.
const TIM2_TRGO: u8 = 6;
/// Sampling time; with the conversion 27 cycles at 21 MHz.
const SAMPLING: SampleTime = SampleTime::CYCLES15;
/// Time from the first trigger to the end of the block, µs: 95 periods and a scan.
const BLOCK_US: Micros = 997;
/// Time for the converter to settle after it is switched on, µs; 3 at most by its data sheet.
const SETTLING_US: u32 = 5;
/// Timeout without samples: the stream has stopped.
const SAMPLE_TIMEOUT: Duration = Duration::from_millis(3);
/// Counts of TIM2 at which an injected conversion may begin. A scan ends at 647; an earlier injected conversion would
/// restart the scan's last channel. The injected conversion must end before the next scan begins.
const BETWEEN: core::ops::Range<u32> = 648..TOP - 150;
/// Polls of a stream after its stop was requested; the stream first ends its transfer.
const STOP_POLLS: u32 = 1000;
/// Flags of the status register; a flag written as 1 is unchanged.
const FLAGS: u32 = 0x3f;
/// Flag of the end of the injected conversion.
const JEOC: u32 = 1 << 2;

/// Two blocks, written by the stream.
static RING: [AtomicU16; 2 * BLOCK] = [const { AtomicU16::new(0) }; 2 * BLOCK];
/// Number of full blocks since the start.
static FULL: AtomicU32 = AtomicU32::new(0);
static READY: Signal<CriticalSectionRawMutex, Ready> = Signal::new();

/// A block that is full.
#[derive(Clone, Copy)]
struct Ready {
    half: Half,
    number: u32,
    local: Micros,
}

/// The converter.
pub struct Converter {
    samples: &'static mut [u16; BLOCK],
    /// Time of the latest full block.
    last: Option<Micros>,
}

impl Converter {
    /// Starts the scans of these channels; `injected` is converted between them.
    pub fn start(
        _adc: Peri<'static, ADC1>,
        _stream: Peri<'static, DMA2_CH0>,
        _timer: Peri<'static, TIM2>,
        scan: [u8; CHANNELS],
        injected: u8,
    ) -> Self {
        static SAMPLES: ConstStaticCell<[u16; BLOCK]> = ConstStaticCell::new([0; BLOCK]);
        // The clock of DMA2 runs since the HAL was started.
        rcc::enable_and_reset::<ADC1>();
        rcc::enable_and_reset::<TIM2>();
        configure(scan, injected);
        pac::TIM2.cr1().write(|w| w.set_arpe(true));
        pac::TIM2.cr2().write(|w| w.set_mms(Mms::UPDATE));
        run(0);
        Self {
            samples: SAMPLES.take(),
            last: None,
        }
    }

    /// Waits for the next whole block; returns the samples and the local time at which the block was full, `None` after
    /// a timeout. A block that was overwritten before it was read is skipped.
    pub async fn read(&mut self) -> Option<(Micros, &[u16; BLOCK])> {
        loop {
            let ready = with_timeout(SAMPLE_TIMEOUT, READY.wait()).await.ok()?;
            let half = RING.iter().skip(ready.half.begins(BLOCK));
            for (sample, cell) in self.samples.iter_mut().zip(half) {
                *sample = cell.load(Ordering::Relaxed);
            }
            compiler_fence(Ordering::SeqCst);
            if FULL.load(Ordering::Relaxed) == ready.number {
                self.last = Some(ready.local);
                return Some((ready.local, self.samples));
            }
        }
    }

    /// Restarts with the first channel, in phase with the previous blocks.
    pub fn restart(&mut self) {
        if !stop() {
            // `read` then times out, and its caller calls `restart` again.
            return;
        }
        let now = Instant::now().as_micros();
        run(self.last.map_or(0, |last| {
            dma_halves::until_in_phase(now, BLOCK_US, last, TICK)
        }));
    }

    /// Latest result of the injected conversion; `None` without a new result since the last call.
    pub fn injected(&mut self) -> Option<u16> {
        let converted = pac::ADC1.sr().read().jeoc();
        pac::ADC1.sr().write_value(Sr(FLAGS & !JEOC));
        converted.then(|| pac::ADC1.jdr(0).read().jdata())
    }

    /// Lengthens the periods from the next scan on by `by` parts in 875; negative values shorten them.
    pub fn trim(&mut self, by: i8) {
        pac::TIM2
            .arr()
            .write_value(TOP.wrapping_add_signed(by.into()));
    }
}

/// Sets the registers that never change afterwards; the converter must be off.
fn configure(scan: [u8; CHANNELS], injected: u8) {
    // 84 MHz / 4.
    pac::ADC123_COMMON
        .ccr()
        .modify(|w| w.set_adcpre(Adcpre::DIV4));
    pac::ADC1.cr1().write(|w| w.set_scan(true));
    for channel in scan.into_iter().chain([injected]) {
        let channel = usize::from(channel);
        match channel.checked_sub(10) {
            None => pac::ADC1.smpr2().modify(|w| w.set_smp(channel, SAMPLING)),
            Some(n) => pac::ADC1.smpr1().modify(|w| w.set_smp(n, SAMPLING)),
        }
    }
    pac::ADC1.sqr1().write(|w| w.set_l(CHANNELS as u8 - 1));
    pac::ADC1.sqr3().write(|w| {
        for (rank, channel) in scan.into_iter().enumerate() {
            w.set_sq(rank, channel);
        }
    });
    // A sequence of one conversion uses the last of four ranks.
    pac::ADC1.jsqr().write(|w| w.set_jsq(3, injected));
}

/// Starts stream, converter and timer, which must be stopped. The first scan begins after `wait` µs, at least one
/// period.
fn run(wait: Micros) {
    let stream = DMA2.st(0);
    stream.par().write_value(pac::ADC1.dr().as_ptr() as u32);
    stream.m0ar().write_value(RING.as_ptr() as u32);
    stream.ndtr().write(|w| w.set_ndt(2 * BLOCK as u16));
    // Channel, direction and FIFO keep their reset values: channel 0, peripheral to memory, no FIFO.
    stream.cr().write(|w| {
        w.set_pl(Pl::VERY_HIGH);
        w.set_psize(Size::BITS16);
        w.set_msize(Size::BITS16);
        w.set_minc(true);
        w.set_circ(true);
        w.set_htie(true);
        w.set_tcie(true);
    });
    stream.cr().modify(|w| w.set_en(true));

    // An update loads the first period at once, while the converter ignores its trigger. The following
    // period waits in the preload register.
    let first = (wait as u32 * COUNTS_PER_US).saturating_sub(1).max(TOP);
    pac::TIM2.arr().write_value(first);
    pac::TIM2.egr().write(|w| w.set_ug(true));
    pac::TIM2.arr().write_value(TOP);

    pac::ADC1.cr2().write(|w| {
        w.set_adon(true);
        w.set_dma(true);
        w.set_dds(Dds::CONTINUOUS);
        w.set_extsel(TIM2_TRGO);
        w.set_exten(Exten::RISING_EDGE);
    });
    cortex_m::asm::delay(SETTLING_US * (CORE_HZ / 1_000_000));
    pac::TIM2.cr1().modify(|w| w.set_cen(true));
}

/// Stops stream, timer and converter; true if the stream has stopped.
fn stop() -> bool {
    let stream = DMA2.st(0);
    // The stream's interrupts are off, because the handler changes the converter's registers too.
    stream.cr().modify(|w| {
        w.set_htie(false);
        w.set_tcie(false);
        w.set_en(false);
    });
    let stopped = (0..STOP_POLLS).any(|_| !stream.cr().read().en());
    pac::TIM2.cr1().modify(|w| w.set_cen(false));
    // Switching the converter off makes the next scan begin with the first channel. A pending DMA request and the
    // overrun flag would prevent further requests.
    pac::ADC1.cr2().write(|_| {});
    // Read the result that was not fetched, so that it is not the first of the next scan.
    pac::ADC1.dr().read();
    pac::ADC1.sr().write_value(Sr(0));
    // A stopped stream sets its flag of completion, and a stream does not start while a flag is set.
    DMA2.ifcr(0).write(|w| {
        w.set_feif(0, true);
        w.set_dmeif(0, true);
        w.set_teif(0, true);
        w.set_htif(0, true);
        w.set_tcif(0, true);
    });
    interrupt::DMA2_STREAM0.unpend();
    READY.reset();
    stopped
}

#[handler]
fn DMA2_STREAM0() {
    let local = Instant::now().as_micros();
    // The bus's handlers could interrupt this handler between check and start, and the start would be too late.
    critical::all(|_| {
        if BETWEEN.contains(&pac::TIM2.cnt().read()) {
            pac::ADC1.cr2().modify(|w| w.set_jswstart(true));
        }
    });
    let flags = DMA2.isr(0).read();
    let (half, complete) = (flags.htif(0), flags.tcif(0));
    DMA2.ifcr(0).write(|w| {
        w.set_htif(0, half);
        w.set_tcif(0, complete);
    });
    let (blocks, half) = dma_halves::full(half, complete);
    // Only this handler writes `FULL`.
    let number = FULL.load(Ordering::Relaxed).wrapping_add(blocks);
    FULL.store(number, Ordering::Relaxed);
    if let Some(half) = half {
        READY.signal(Ready {
            half,
            number,
            local,
        });
    }
}
