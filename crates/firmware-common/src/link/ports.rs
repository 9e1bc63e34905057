//! Serial port and bus frames of the link.

use core::future::pending;

use core_algos::bus::CanFrame;
use embassy_futures::select::{Either, select};
use embassy_time::Timer;

use super::driving::Event;
use super::uart::Uart;
use super::{Output, Route};
use crate::can::ServicePort;

/// Serial port of the link and its frames on the bus.
pub struct Ports {
    /// Serial port of the board.
    pub uart: Uart,
    /// Frames of the link on the bus; `None` in a session at the serial port, which does not start the bus.
    pub service: Option<ServicePort>,
}

impl Ports {
    /// Waits for bytes or for a frame of the link.
    pub async fn receive<'a>(&mut self, buffer: &'a mut [u8]) -> Event<'a> {
        let Self { uart, service } = self;
        let frame = async {
            match service {
                Some(service) => service.receive().await,
                None => pending().await,
            }
        };
        let received = select(uart.read(buffer), frame).await;
        match received {
            Either::First(count) => Event::Bytes(buffer.get(..count).unwrap_or_default()),
            Either::Second(frame) => Event::Frame(frame),
        }
    }

    /// Waits until all bytes and frames are sent.
    pub async fn flush(&mut self, route: Route) {
        if route == Route::Serial {
            return self.uart.flush();
        }
        while self.service.as_ref().is_some_and(|port| !port.is_sent()) {
            Timer::after_millis(1).await;
        }
        // 20 ms is longer than a frame waits on a busy bus.
        Timer::after_millis(20).await;
    }
}

impl Output for Ports {
    fn write(&mut self, bytes: &[u8]) {
        self.uart.write(bytes);
    }

    fn is_free(&self) -> bool {
        self.uart.is_free()
    }

    fn send(&mut self, frames: impl Iterator<Item = CanFrame>) {
        if let Some(service) = &mut self.service {
            service.send(frames);
        }
    }
}
