//! What the UARTs of real and emulated boards have in common.

use embassy_stm32::usart::BufferedUartTx;
use embedded_io::Write;

/// Symbols a second; 42 MHz give 913 043, 0.9 % slow, well within what a UART tolerates.
pub const BAUD: u32 = 921_600;
/// Bytes that wait to be sent or read: the longest frame and more.
pub const ROOM: usize = 2 * core_algos::hil::framing::MAX_FRAME;

/// Sends a frame. The driver can miss bytes put behind others whose sending ends at that moment, so
/// the frame is sent out before the next; it reports no errors.
pub fn send(tx: &mut BufferedUartTx, bytes: &[u8]) {
    let _ = tx.write_all(bytes).and_then(|()| tx.flush());
}
