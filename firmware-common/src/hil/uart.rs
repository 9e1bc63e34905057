//! The UART link: USART3 at 921 600 baud, TX on PB10, RX on PB11.
//!
//! The emulated board receives on USART2 instead: in QEMU's model the HAL's transmit path, which
//! reads and writes the status register, can lose a byte that arrives at that moment.

use core::future::poll_fn;
use core::pin::pin;
use core::task::Poll;

use embassy_stm32::usart::{self, BufferedUart, BufferedUartRx, BufferedUartTx, Config};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embedded_io::Write;
use embedded_io_async::Read;
use static_cell::ConstStaticCell;

use super::Link;

/// Symbols a second; 42 MHz give 913 043, 0.9 % slow, well within what a UART tolerates.
pub const BAUD: u32 = 921_600;

/// Bytes that wait to be sent or read: the longest frame and more.
const ROOM: usize = 2 * core_algos::hil::framing::MAX_FRAME;
static TX_BUFFER: ConstStaticCell<[u8; ROOM]> = ConstStaticCell::new([0; ROOM]);
static RX_BUFFER: ConstStaticCell<[u8; ROOM]> = ConstStaticCell::new([0; ROOM]);

bind_interrupts!(struct Irqs {
    USART2 => usart::BufferedInterruptHandler<peripherals::USART2>;
    USART3 => usart::BufferedInterruptHandler<peripherals::USART3>;
});

/// The UART, ready.
pub struct Uart {
    rx: BufferedUartRx<'static>,
    tx: BufferedUartTx<'static>,
}

fn config() -> Config {
    let mut config = Config::default();
    config.baudrate = BAUD;
    // QEMU has no idle interrupt: every byte must wake the reader.
    config.eager_reads = cfg!(feature = "emulated").then_some(1);
    config
}

impl Uart {
    /// Sets it up; to be called once, its buffers are static.
    #[cfg(not(feature = "emulated"))]
    pub fn new(
        uart: Peri<'static, peripherals::USART3>,
        rx: Peri<'static, peripherals::PB11>,
        tx: Peri<'static, peripherals::PB10>,
    ) -> Self {
        let (tx_buffer, rx_buffer) = (TX_BUFFER.take(), RX_BUFFER.take());
        let uart = BufferedUart::new(uart, rx, tx, tx_buffer, rx_buffer, Irqs, config());
        let (tx, rx) = expect(uart).split();
        Self { rx, tx }
    }

    /// The same with a receiver of its own.
    #[cfg(feature = "emulated")]
    pub fn emulated(
        receiver: Peri<'static, peripherals::USART2>,
        rx: Peri<'static, peripherals::PA3>,
        unused_tx: Peri<'static, peripherals::PA2>,
        transmitter: Peri<'static, peripherals::USART3>,
        unused_rx: Peri<'static, peripherals::PB11>,
        tx: Peri<'static, peripherals::PB10>,
    ) -> Self {
        static NO_TX: ConstStaticCell<[u8; 1]> = ConstStaticCell::new([0]);
        static NO_RX: ConstStaticCell<[u8; 1]> = ConstStaticCell::new([0]);
        let (tx_buffer, rx_buffer) = (TX_BUFFER.take(), RX_BUFFER.take());
        let receiver = BufferedUart::new(
            receiver,
            rx,
            unused_tx,
            NO_TX.take(),
            rx_buffer,
            Irqs,
            config(),
        );
        let transmitter = BufferedUart::new(
            transmitter,
            unused_rx,
            tx,
            tx_buffer,
            NO_RX.take(),
            Irqs,
            config(),
        );
        Self {
            rx: expect(receiver).split().1,
            tx: expect(transmitter).split().0,
        }
    }
}

/// The rate is fixed, so the clock divider always fits.
fn expect<T>(uart: Result<T, usart::ConfigError>) -> T {
    uart.unwrap_or_else(|error| panic!("USART: {error:?}"))
}

impl Link for Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> usize {
        loop {
            let mut read = pin!(self.rx.read(buffer));
            // The driver looks for bytes before it leaves its waker, and misses one that comes in
            // between; so it is asked again.
            let read = poll_fn(|context| match read.as_mut().poll(context) {
                Poll::Pending => read.as_mut().poll(context),
                ready => ready,
            });
            // Errors of the line (overrun, noise, framing) spoil a frame, whose check finds it.
            if let Ok(count) = read.await {
                return count;
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) {
        // The driver reports no errors of sending. It can miss bytes put behind others whose sending
        // ends at that moment, so each frame is sent out before the next.
        let _ = self.tx.write_all(bytes).and_then(|()| self.tx.flush());
    }
}
