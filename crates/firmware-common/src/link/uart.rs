//! USART3 (TX on PB10, RX on PB11) with DMA1 in both directions (RM0090, chapters 10 and 30).
//!
//! The HAL's drivers are not used. The buffered driver has an interrupt per byte, the ring buffer driver reads the
//! data register in each call, and the DMA driver panics on an empty write.
//!
//! Stream 1 writes received bytes into a ring buffer. The idle line after the last byte wakes the reader: the host
//! sends one request and waits for its reply.

use core::sync::atomic::{AtomicU8, Ordering, compiler_fence};

use core_algos::link::framing::MAX_FRAME;
use embassy_stm32::gpio::{AfType, Flex, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::dma::vals::Dir;
use embassy_stm32::pac::{self, DMA1};
use embassy_stm32::peripherals::{PB10, PB11, USART3};
use embassy_stm32::{Peri, interrupt as handler, rcc};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use static_cell::ConstStaticCell;

/// Baud rate; the 42 MHz clock gives 913 043, 0.9 % slow, within the tolerance of a UART.
const BAUD: u32 = 921_600;
/// Clock of APB1, from which the baud rate is divided, Hz.
const CLOCK_HZ: u32 = 42_000_000;
/// Alternate function of the pins.
const ALTERNATE: u8 = 7;
/// Streams of the receiver and the transmitter, and the channel of both.
const RX: usize = 1;
const TX: usize = 3;
const CHANNEL: u8 = 4;
/// Size of the receive buffer, bytes: two of the longest frames.
const RING_BYTES: usize = 2 * MAX_FRAME;

static RING: [AtomicU8; RING_BYTES] = [const { AtomicU8::new(0) }; RING_BYTES];
static IDLE: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static SENT: Signal<CriticalSectionRawMutex, ()> = Signal::new();
/// Status bits that a write of 1 keeps: all except transmission complete.
const KEPT: u32 = 0x3ff & !(1 << 6);

/// Driver of the serial port.
pub struct Uart {
    /// Read position in the ring buffer.
    read: usize,
    sending: &'static mut [u8; MAX_FRAME],
}

impl Uart {
    /// Starts the port; call it once.
    pub fn start(
        _uart: Peri<'static, USART3>,
        rx: Peri<'static, PB11>,
        tx: Peri<'static, PB10>,
    ) -> Self {
        static SENDING: ConstStaticCell<[u8; MAX_FRAME]> = ConstStaticCell::new([0; MAX_FRAME]);
        // The HAL has already started the clock of DMA1.
        rcc::enable_and_reset::<USART3>();
        let (mut rx, mut tx) = (Flex::new(rx), Flex::new(tx));
        // The pull-up keeps the input from floating without an adapter.
        rx.set_as_af_unchecked(ALTERNATE, AfType::input(Pull::Up));
        tx.set_as_af_unchecked(
            ALTERNATE,
            AfType::output(OutputType::PushPull, Speed::Medium),
        );
        // Dropping the pins would disconnect them.
        core::mem::forget((rx, tx));

        let uart = pac::USART3;
        let stream = DMA1.st(RX);
        stream.par().write_value(uart.dr().as_ptr() as u32);
        stream.m0ar().write_value(RING.as_ptr() as u32);
        stream.ndtr().write(|w| w.set_ndt(RING_BYTES as u16));
        stream.cr().write(|w| {
            w.set_chsel(CHANNEL);
            w.set_minc(true);
            w.set_circ(true);
            w.set_en(true);
        });
        uart.brr()
            .write_value(pac::usart::regs::Brr((CLOCK_HZ + BAUD / 2) / BAUD));
        uart.cr3().write(|w| {
            w.set_dmar(true);
            w.set_dmat(true);
        });
        // The priority is below the tick and above the thread, whose reader the handler wakes.
        interrupt::USART3.set_priority(Priority::P6);
        interrupt::USART3.unpend();
        // SAFETY: the interrupt has a handler, which shares only signals with the program.
        unsafe { interrupt::USART3.enable() };
        uart.cr1().write(|w| {
            w.set_ue(true);
            w.set_te(true);
            w.set_re(true);
            w.set_idleie(true);
        });
        Self {
            read: 0,
            sending: SENDING.take(),
        }
    }

    /// Waits for bytes; returns the number read, at least one.
    pub async fn read(&mut self, buffer: &mut [u8]) -> usize {
        loop {
            let left = usize::from(DMA1.st(RX).ndtr().read().ndt());
            let written = (RING_BYTES - left) % RING_BYTES;
            let count = ((written + RING_BYTES - self.read) % RING_BYTES).min(buffer.len());
            if count == 0 {
                IDLE.wait().await;
                continue;
            }
            compiler_fence(Ordering::Acquire);
            for byte in &mut buffer[..count] {
                *byte = RING[self.read].load(Ordering::Relaxed);
                self.read = (self.read + 1) % RING_BYTES;
            }
            return count;
        }
    }

    /// True if DMA has read the whole previous frame, so that a new frame can start.
    pub fn is_free(&self) -> bool {
        !DMA1.st(TX).cr().read().en()
    }

    /// Sends a frame after the previous one; bytes beyond the longest frame are cut off.
    pub fn write(&mut self, bytes: &[u8]) {
        let stream = DMA1.st(TX);
        // A stream of length zero would neither start nor end.
        if bytes.is_empty() {
            return;
        }
        while stream.cr().read().en() {}
        let count = bytes.len().min(MAX_FRAME);
        self.sending[..count].copy_from_slice(&bytes[..count]);
        compiler_fence(Ordering::Release);
        // Clear all flags: a stream with an error flag of the previous frame would not start (RM0090, 10.3.17).
        DMA1.ifcr(TX / 4).write(|w| {
            w.set_feif(TX % 4, true);
            w.set_dmeif(TX % 4, true);
            w.set_teif(TX % 4, true);
            w.set_htif(TX % 4, true);
            w.set_tcif(TX % 4, true);
        });
        stream.par().write_value(pac::USART3.dr().as_ptr() as u32);
        stream.m0ar().write_value(self.sending.as_ptr() as u32);
        stream.ndtr().write(|w| w.set_ndt(count as u16));
        SENT.reset();
        pac::USART3.sr().write_value(pac::usart::regs::Sr(KEPT));
        stream.cr().write(|w| {
            w.set_chsel(CHANNEL);
            w.set_dir(Dir::MEMORY_TO_PERIPHERAL);
            w.set_minc(true);
            w.set_en(true);
        });
        pac::USART3.cr1().modify(|w| w.set_tcie(true));
    }

    /// Waits until all bytes are sent.
    pub fn flush(&mut self) {
        while DMA1.st(TX).cr().read().en() {}
        // The last two bytes are in the data and shift registers; each takes 11 µs.
        cortex_m::asm::delay(2 * 11 * (crate::clock::CORE_HZ / 1_000_000));
    }
}

/// Waits until the current frame is sent.
pub async fn sent() {
    SENT.wait().await;
}

#[handler]
fn USART3() {
    let status = pac::USART3.sr().read();
    if status.idle() {
        // A read of the data register after the status clears the flags, including those of line errors. The frame
        // check detects line errors. The read loses no byte: DMA fetched the last byte one byte time ago.
        pac::USART3.dr().read();
        IDLE.signal(());
    }
    if status.tc() {
        pac::USART3.cr1().modify(|w| w.set_tcie(false));
        SENT.signal(());
    }
}
