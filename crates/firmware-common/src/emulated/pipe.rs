//! Link through two named pipes of the host, by semihosting file calls.
//!
//! A call stops the whole emulated board until the host has answered; in lockstep the board would
//! only wait anyway. It takes a twentieth of the time of the emulated UART.

use semihosting::fs::{File, OpenOptions};
use semihosting::io::{Read, Write};

use super::host_gone;
use super::options::Options;
use crate::hil::Link;

/// The two pipes, open.
pub struct Pipe {
    input: File,
    output: File,
}

impl Pipe {
    /// Opens `in=` to read, then `out=` to write; each waits until the host has opened its end.
    pub fn open(options: &Options) -> Option<Self> {
        let (input, output) = (options.path("in")?, options.path("out")?);
        let input = File::open(input.as_c_str()).ok()?;
        let output = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(output.as_c_str())
            .ok()?;
        Some(Self { input, output })
    }
}

impl Link for Pipe {
    async fn read(&mut self, buffer: &mut [u8]) -> usize {
        match self.input.read(buffer) {
            Ok(count) if count > 0 => count,
            _ => host_gone(),
        }
    }

    fn write(&mut self, bytes: &[u8]) {
        if self.output.write_all(bytes).is_err() {
            host_gone()
        }
    }
}
