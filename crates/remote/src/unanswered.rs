//! Diagnosis of bytes that arrive at a port without a reply.

use std::fmt;

/// Bytes received without a reply to the request sent.
#[derive(Clone, Debug, Default)]
pub struct Unanswered {
    request: Vec<u8>,
    count: usize,
    /// First received bytes, at most as many as the request has.
    first: Vec<u8>,
}

impl Unanswered {
    /// Starts the diagnosis of a request to which no bytes were received yet.
    pub fn to(request: &[u8]) -> Self {
        Self {
            request: without_delimiters(request).to_owned(),
            ..Self::default()
        }
    }

    /// Adds received bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        self.count += bytes.len();
        let bytes = match self.first.is_empty() {
            true => without_delimiters(bytes),
            false => bytes,
        };
        let missing = (self.request.len().max(1)).saturating_sub(self.first.len());
        self.first.extend(bytes.iter().take(missing));
    }

    /// True until bytes are received.
    pub fn is_new(&self) -> bool {
        self.count == 0
    }

    /// True if the first received bytes are the request itself.
    pub fn is_echo(&self) -> bool {
        !self.request.is_empty() && self.first == self.request
    }
}

/// The bytes after the leading frame delimiters.
fn without_delimiters(bytes: &[u8]) -> &[u8] {
    let start = bytes.iter().position(|byte| *byte != 0);
    bytes
        .get(start.unwrap_or(bytes.len())..)
        .unwrap_or_default()
}

impl fmt::Display for Unanswered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.count, self.first.first()) {
            (0, _) => f.write_str("nothing arrived"),
            _ if self.is_echo() => f.write_str(
                "the port returns every byte: its TX is connected to its RX, or its adapter echoes and has no board",
            ),
            (count, first) => write!(
                f,
                "{count} bytes arrived that are not an answer, the first is {:#04x}: the baud rate differs, or another \
                 program runs on the board",
                first.unwrap_or(&0)
            ),
        }
    }
}
