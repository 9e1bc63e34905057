//! Classical CAN frames: fields, checksum, bit stuffing, sequence of bits on the bus (ISO 11898-1).

/// Identifier of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Id {
    /// Identifier of 11 bits.
    Standard(u16),
    /// Identifier of 29 bits.
    Extended(u32),
}

/// A data frame or a remote frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: Id,
    remote: bool,
    code: u8,
    data: [u8; 8],
}

impl Frame {
    /// A data frame. Only the first eight bytes of `data` are used; the identifier is truncated to its width.
    pub fn new(id: Id, data: &[u8]) -> Self {
        let length = data.len().min(8);
        let mut bytes = [0; 8];
        bytes[..length].copy_from_slice(&data[..length]);
        Self::raw(id, false, length as u8, bytes)
    }

    /// A remote frame that requests `length` bytes.
    pub fn remote(id: Id, length: u8) -> Self {
        Self::raw(id, true, length, [0; 8])
    }

    /// A frame from its fields. A length code above 8, which the standard allows, means eight bytes.
    pub fn raw(id: Id, remote: bool, code: u8, data: [u8; 8]) -> Self {
        let id = match id {
            Id::Standard(id) => Id::Standard(id & 0x7ff),
            Id::Extended(id) => Id::Extended(id & 0x1fff_ffff),
        };
        let mut frame = Self {
            id,
            remote,
            code: code & 15,
            data: [0; 8],
        };
        let count = frame.count();
        frame.data[..count].copy_from_slice(&data[..count]);
        frame
    }

    /// The identifier.
    pub fn id(&self) -> Id {
        self.id
    }

    /// True for a remote frame, which requests data and carries none.
    pub fn is_remote(&self) -> bool {
        self.remote
    }

    /// Data length code as transmitted.
    pub fn code(&self) -> u8 {
        self.code
    }

    /// Data bytes of the frame; empty for a remote frame.
    pub fn data(&self) -> &[u8] {
        &self.data[..self.count()]
    }

    fn count(&self) -> usize {
        if self.remote {
            0
        } else {
            self.code.min(8).into()
        }
    }

    /// Priority in arbitration: the bits of the arbitration field; the lowest value wins.
    pub fn priority(&self) -> u32 {
        let remote = u32::from(self.remote);
        match self.id {
            Id::Standard(id) => u32::from(id) << 21 | remote << 20,
            Id::Extended(id) => id >> 18 << 21 | 3 << 19 | (id & 0x3_ffff) << 1 | remote,
        }
    }

    /// Bits on the bus, from the start of frame to the end-of-frame field.
    pub fn bits(&self) -> Bits {
        let mut bits = Stuffer::default();
        bits.put(0, 1);
        match self.id {
            Id::Standard(id) => {
                bits.put(id.into(), 11);
                bits.put(self.remote.into(), 1);
                bits.end_arbitration();
                bits.put(0, 2);
            }
            Id::Extended(id) => {
                bits.put(id >> 18, 11);
                bits.put(3, 2);
                bits.put(id & 0x3_ffff, 18);
                bits.put(self.remote.into(), 1);
                bits.end_arbitration();
                bits.put(0, 2);
            }
        }
        bits.put(self.code.into(), 4);
        for &byte in self.data() {
            bits.put(byte.into(), 8);
        }
        bits.finish()
    }
}

/// Bits behind the stuffed part: checksum delimiter, acknowledgement and its delimiter, end of frame.
const TAIL: usize = 3 + 7;

/// Remainder of the checksum after one more bit.
pub(crate) const fn crc_step(crc: u16, bit: bool) -> u16 {
    let next = crc << 1;
    let feedback = (crc >> 14 & 1 == 1) != bit;
    (if feedback { next ^ 0x4599 } else { next }) & 0x7fff
}

/// Bits of a frame on the bus, including stuff bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bits {
    recessive: [u64; 3],
    stuffed: [u64; 3],
    length: u8,
    /// Index of the last bit of the arbitration field.
    arbitration: u8,
}

impl Bits {
    /// Number of bits, without the intermission.
    pub fn length(&self) -> usize {
        self.length.into()
    }

    /// True if bit `i` is recessive, the level of a logical 1.
    pub fn recessive(&self, i: usize) -> bool {
        self.recessive[i / 64] >> (i % 64) & 1 == 1
    }

    /// True if bit `i` is a stuff bit.
    pub fn is_stuff_bit(&self, i: usize) -> bool {
        self.stuffed[i / 64] >> (i % 64) & 1 == 1
    }

    /// True if bit `i` belongs to the arbitration field.
    pub(crate) fn is_arbitration(&self, i: usize) -> bool {
        i <= self.arbitration.into()
    }

    /// Index of the acknowledgement slot.
    pub fn acknowledgement(&self) -> usize {
        self.length() - 9
    }

    /// All bits; true is recessive.
    pub fn iter(&self) -> impl Iterator<Item = bool> + '_ {
        (0..self.length()).map(|i| self.recessive(i))
    }

    fn push(&mut self, recessive: bool, stuffed: bool) {
        let (word, bit) = (self.length() / 64, self.length() % 64);
        self.recessive[word] |= u64::from(recessive) << bit;
        self.stuffed[word] |= u64::from(stuffed) << bit;
        self.length += 1;
    }
}

/// Inserts stuff bits and computes the checksum.
#[derive(Default)]
struct Stuffer {
    bits: Bits,
    crc: u16,
    run: u8,
    last: bool,
}

impl Stuffer {
    fn put(&mut self, value: u32, count: u32) {
        for k in (0..count).rev() {
            self.push(value >> k & 1 == 1);
        }
    }

    fn push(&mut self, bit: bool) {
        if self.run == 5 {
            self.last = !self.last;
            self.run = 1;
            self.bits.push(self.last, true);
        }
        self.run = if self.run > 0 && bit == self.last {
            self.run + 1
        } else {
            1
        };
        self.last = bit;
        self.crc = crc_step(self.crc, bit);
        self.bits.push(bit, false);
    }

    fn end_arbitration(&mut self) {
        self.bits.arbitration = self.bits.length - 1;
    }

    fn finish(mut self) -> Bits {
        self.put(self.crc.into(), 15);
        if self.run == 5 {
            self.bits.push(!self.last, true);
        }
        for _ in 0..TAIL {
            self.bits.push(true, false);
        }
        self.bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stuffed bits decoded by the rules of the standard, independently of the encoder.
    fn destuffed(bits: &Bits) -> Vec<bool> {
        let mut out: Vec<bool> = Vec::new();
        let (mut run, mut last) = (0, None);
        for bit in bits.iter().take(bits.length() - TAIL) {
            if run == 5 {
                assert_ne!(Some(bit), last, "six equal bits");
                (run, last) = (1, Some(bit));
                continue;
            }
            run = if Some(bit) == last { run + 1 } else { 1 };
            last = Some(bit);
            out.push(bit);
        }
        out
    }

    #[test]
    fn priority_orders_frames_as_arbitration_does() {
        let mut frames = Vec::new();
        for id in [0x100u32, 0x101, 0x7ff] {
            for remote in [false, true] {
                frames.push(Frame::raw(Id::Standard(id as u16), remote, 0, [0; 8]));
                for low in [0, 1, 0x3_ffff] {
                    frames.push(Frame::raw(Id::Extended(id << 18 | low), remote, 0, [0; 8]));
                }
            }
        }
        for a in &frames {
            for b in &frames {
                let (x, y) = (destuffed(&a.bits()), destuffed(&b.bits()));
                // At the first different bit, dominant wins.
                let wins = x.iter().zip(&y).find(|(p, q)| p != q);
                if let Some((p, q)) = wins {
                    assert_eq!(a.priority().cmp(&b.priority()), p.cmp(q), "{a:?} {b:?}");
                }
            }
        }
    }
}
