//! Prints random CAN frames with their bits on the bus, one per line, for `oracle/can_bits.py`: `FORMAT IDENTIFIER KIND
//! LENGTH-CODE DATA BITS`. The bits are those from the start of frame to the end of the end-of-frame field, 1 for
//! recessive.
//!
//! `cargo run -p virtual-board --example can_frames [COUNT [SEED]]`

use virtual_board::wire::{Frame, Id};

/// Pseudo-random numbers (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// Random number below `end`.
    fn below(&mut self, end: u64) -> u64 {
        (self.next() >> 11) % end
    }

    /// Random bits with long runs of equal bits, which need stuffing.
    fn word(&mut self) -> u64 {
        match self.below(4) {
            0 => self.next(),
            1 => self.next() & self.next() & self.next(),
            2 => self.next() | self.next() | self.next(),
            _ => {
                [0, u64::MAX, 0xf0f0_f0f0_f0f0_f0f0, 0x1f1f_1f1f_1f1f_1f1f][self.below(4) as usize]
            }
        }
    }

    fn frame(&mut self) -> Frame {
        let id = if self.below(2) == 0 {
            Id::Standard(self.word() as u16)
        } else {
            Id::Extended(self.word() as u32)
        };
        let code = self.below(9) as u8;
        if self.below(8) == 0 {
            return Frame::remote(id, code);
        }
        let code = if self.below(32) == 0 { code | 8 } else { code };
        Frame::raw(id, false, code, self.word().to_le_bytes())
    }
}

fn line(frame: &Frame) -> String {
    let (format, id) = match frame.id() {
        Id::Standard(id) => ("standard", u32::from(id)),
        Id::Extended(id) => ("extended", id),
    };
    let kind = if frame.is_remote() { "remote" } else { "data" };
    let data: String = frame
        .data()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let data = if data.is_empty() { "-" } else { &data };
    let bits: String = frame
        .bits()
        .iter()
        .map(|bit| if bit { '1' } else { '0' })
        .collect();
    format!("{format} {id:x} {kind} {} {data} {bits}", frame.code())
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let mut number = |default: u64| {
        let given = arguments.next().and_then(|text| text.parse().ok());
        given.unwrap_or(default)
    };
    let count = number(10_000);
    let mut random = Random(number(1).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    for _ in 0..count {
        println!("{}", line(&random.frame()));
    }
}
