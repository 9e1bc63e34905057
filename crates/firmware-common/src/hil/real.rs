//! The link of a real board: USART3, TX on PB10, RX on PB11.

use embassy_stm32::peripherals::{PB10, PB11, USART3};
use embassy_stm32::usart::{
    self, BufferedInterruptHandler, BufferedUart, BufferedUartRx, BufferedUartTx, ConfigError,
};
use embassy_stm32::{Peri, Peripherals, bind_interrupts};
use embedded_io_async::Read;
use static_cell::ConstStaticCell;

use core_algos::hil::Identity;
use core_algos::topology::{AxleId, Role};

use super::uart::{BAUD, ROOM, send};
use super::{Kind, Link, serve};
use crate::board_id;
use crate::store::chip::open;
use crate::watchdog::Watchdog;

bind_interrupts!(struct Irqs {
    USART3 => BufferedInterruptHandler<USART3>;
});

/// Runs the board's nodes behind its link, for ever. `build` says what the image was built from.
pub async fn run(p: Peripherals, kind: Kind, build: &'static str) -> ! {
    let watchdog = Watchdog::start();
    let role = match kind {
        Kind::Axle => match board_id::axle(p.PC13) {
            AxleId::Front => Role::Front,
            AxleId::Rear => Role::Rear,
        },
        Kind::Beam => Role::Beam,
    };
    let link = Uart::new(p.USART3, p.PB11, p.PB10).expect("the rate is fixed and fits");
    serve(link, watchdog, Identity { build, role }, open(p.FLASH)).await
}

/// The UART, ready.
struct Uart {
    rx: BufferedUartRx<'static>,
    tx: BufferedUartTx<'static>,
}

impl Uart {
    /// Sets it up; to be called once, its buffers are static.
    fn new(
        uart: Peri<'static, USART3>,
        rx: Peri<'static, PB11>,
        tx: Peri<'static, PB10>,
    ) -> Result<Self, ConfigError> {
        static SENDING: ConstStaticCell<[u8; ROOM]> = ConstStaticCell::new([0; ROOM]);
        static RECEIVED: ConstStaticCell<[u8; ROOM]> = ConstStaticCell::new([0; ROOM]);
        let mut config = usart::Config::default();
        config.baudrate = BAUD;
        let (sending, received) = (SENDING.take(), RECEIVED.take());
        let uart = BufferedUart::new(uart, rx, tx, sending, received, Irqs, config)?;
        let (tx, rx) = uart.split();
        Ok(Self { rx, tx })
    }
}

impl Link for Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> usize {
        loop {
            // Errors of the line (overrun, noise, framing) spoil a frame, whose check finds it.
            if let Ok(count) = self.rx.read(buffer).await {
                return count;
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) {
        send(&mut self.tx, bytes);
    }
}
