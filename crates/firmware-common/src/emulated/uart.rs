//! The UART link of an emulated board: receives on USART2, transmits on USART3.
//!
//! In QEMU's model the HAL's transmit path, which writes the status register back, can lose a byte
//! that arrives at that moment; hence two UARTs. There is no idle interrupt, so every byte wakes the
//! reader.

use embassy_stm32::peripherals::{PA2, PA3, PB10, PB11, USART2, USART3};
use embassy_stm32::usart::{
    self, BufferedInterruptHandler, BufferedUart, BufferedUartRx, BufferedUartTx, ConfigError,
};
use embassy_stm32::{Peri, bind_interrupts};
use embedded_io::{Read, ReadReady};
use static_cell::ConstStaticCell;

use super::host_gone;
use crate::hil::Link;
use crate::hil::uart::{BAUD, ROOM, send};

/// Interrupts without a byte after which the host is taken as gone: SysTick alone makes 1000 a
/// second.
const SILENCE: u32 = 300_000;
/// The byte that ends a frame.
const FRAME_END: u8 = 0;

bind_interrupts!(struct Irqs {
    USART2 => BufferedInterruptHandler<USART2>;
    USART3 => BufferedInterruptHandler<USART3>;
});

/// The UARTs, ready.
pub struct Uart {
    rx: BufferedUartRx<'static>,
    tx: BufferedUartTx<'static>,
}

impl Uart {
    /// Sets them up; to be called once, their buffers are static.
    pub fn new(
        receiver: Peri<'static, USART2>,
        rx: Peri<'static, PA3>,
        unused_tx: Peri<'static, PA2>,
        transmitter: Peri<'static, USART3>,
        unused_rx: Peri<'static, PB11>,
        tx: Peri<'static, PB10>,
    ) -> Result<Self, ConfigError> {
        static SENDING: ConstStaticCell<[u8; ROOM]> = ConstStaticCell::new([0; ROOM]);
        static RECEIVED: ConstStaticCell<[u8; ROOM]> = ConstStaticCell::new([0; ROOM]);
        static UNUSED: [ConstStaticCell<[u8; 1]>; 2] = [const { ConstStaticCell::new([0]) }; 2];
        let [no_sending, no_received] = UNUSED.each_ref().map(ConstStaticCell::take);
        let mut config = usart::Config::default();
        config.baudrate = BAUD;
        config.eager_reads = Some(1);
        let received = RECEIVED.take();
        let receiver =
            BufferedUart::new(receiver, rx, unused_tx, no_sending, received, Irqs, config)?;
        let sending = SENDING.take();
        let transmitter = BufferedUart::new(
            transmitter,
            unused_rx,
            tx,
            sending,
            no_received,
            Irqs,
            config,
        )?;
        Ok(Self {
            rx: receiver.split().1,
            tx: transmitter.split().0,
        })
    }
}

impl Link for Uart {
    /// Gives bytes up to the end of a frame, and stops the whole board until they are there: the
    /// executor's wait for an event is none in QEMU, it would keep a core of the host busy.
    ///
    /// After five minutes of silence the emulation ends, lest it outlive a host that was killed.
    async fn read(&mut self, buffer: &mut [u8]) -> usize {
        let mut count = 0;
        let mut silence = 0;
        while count < buffer.len() && buffer[..count].last() != Some(&FRAME_END) {
            // With interrupts masked from the look to the wait, which a pending one ends, no byte
            // is missed.
            critical_section::with(|_| {
                if self.rx.read_ready() == Ok(false) {
                    cortex_m::asm::wfi();
                }
            });
            silence += 1;
            if silence > SILENCE {
                host_gone();
            }
            if self.rx.read_ready() == Ok(true) {
                silence = 0;
                count += self.rx.read(&mut buffer[count..]).unwrap_or(0);
            }
        }
        count
    }

    fn write(&mut self, bytes: &[u8]) {
        send(&mut self.tx, bytes);
    }
}
