//! Bytes at a port that are no answer, and what they say about it.

use std::fmt;

/// Bytes that came without an answer to the request that was sent.
#[derive(Clone, Debug, Default)]
pub struct Unanswered {
    request: Vec<u8>,
    count: usize,
    /// The first bytes, as many as the request has.
    first: Vec<u8>,
}

impl Unanswered {
    /// No bytes yet to this request.
    pub fn to(request: &[u8]) -> Self {
        Self {
            request: without_delimiters(request).to_owned(),
            ..Self::default()
        }
    }

    /// Takes in bytes.
    pub fn hear(&mut self, bytes: &[u8]) {
        self.count += bytes.len();
        let bytes = match self.first.is_empty() {
            true => without_delimiters(bytes),
            false => bytes,
        };
        let room = (self.request.len().max(1)).saturating_sub(self.first.len());
        self.first.extend(bytes.iter().take(room));
    }

    /// True if nothing came yet.
    pub fn is_new(&self) -> bool {
        self.count == 0
    }

    /// True if the request itself came back.
    pub fn is_echo(&self) -> bool {
        !self.request.is_empty() && self.first == self.request
    }
}

/// Bytes from the first frame on.
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
                "the port sends back what it gets: its TX is connected to its RX, or no board is behind an adapter \
                 that echoes",
            ),
            (count, first) => write!(
                f,
                "{count} bytes arrived that are no answer, the first is {:#04x}: another baud rate, or another \
                 program on the board",
                first.unwrap_or(&0)
            ),
        }
    }
}
