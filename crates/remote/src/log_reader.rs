//! Reader of a virtual board's log: a probe reads the log from the board's memory, and the lines are decoded.

use crate::board_log::BoardLog;
use std::io::Read;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use virtual_board::board::Board;
use virtual_board::image::Image;
use virtual_board::probe::rtt::Rtt;

/// Start address of the memory that holds the log.
const SRAM: u32 = 0x2000_0000;

/// Bytes for the decoder, in the order of their arrival.
struct Stream {
    from: Receiver<Vec<u8>>,
    rest: Vec<u8>,
}

impl Read for Stream {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.rest.is_empty() {
            // A dropped sender ends the log.
            self.rest = self.from.recv().unwrap_or_default();
        }
        let count = self.rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.rest[..count]);
        self.rest.drain(..count);
        Ok(count)
    }
}

/// Reads the log of a board. A clone reads the bytes and discards them.
pub struct Reader {
    rtt: Rtt,
    to: Option<Sender<Vec<u8>>>,
    decoder: Option<JoinHandle<()>>,
}

impl Reader {
    /// A reader for a board with this image; lines go to `log`.
    pub fn new(image: &Image, log: &BoardLog) -> Self {
        let (to, from) = channel();
        let stream = Stream {
            from,
            rest: Vec::new(),
        };
        let bytes = Arc::new(image.bytes().to_vec());
        Self {
            rtt: Rtt::new(SRAM, image.symbol("_SEGGER_RTT")),
            to: Some(to),
            decoder: Some(log.follow(bytes, stream)),
        }
    }

    /// Makes the log full and blocking, and stops reading it: the board then waits at its next log entry.
    pub fn hang(&mut self, board: &mut Board) {
        self.rtt.set_blocking(board.chip().sram());
        self.rtt.leave_full(board.chip().sram());
        self.rtt.set_reading(false);
    }

    /// Reads the bytes that the board has written since the last call.
    pub fn read(&mut self, board: &mut Board) {
        let mut bytes = Vec::new();
        self.rtt.poll(board.chip().sram(), &mut bytes);
        if let (false, Some(to)) = (bytes.is_empty(), &self.to) {
            // The send fails if the decoder has ended; later bytes are then lost.
            let _ = to.send(bytes);
        }
    }
}

impl Clone for Reader {
    fn clone(&self) -> Self {
        Self {
            rtt: self.rtt.clone(),
            to: None,
            decoder: None,
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.to = None;
        if let Some(decoder) = self.decoder.take() {
            let _ = decoder.join();
        }
    }
}
