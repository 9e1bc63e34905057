//! SEGGER RTT: the log that a program writes to a ring buffer in its memory and a probe reads.
//!
//! Source: SEGGER UM08001, "Real Time Transfer". The control block begins with `SEGGER RTT`, followed by the numbers of
//! up and down channels and the channels. A channel has six words: name, buffer, size, write offset (target), read
//! offset (host), flags. The flags select the target's behaviour when the buffer is full. A host may set them
//! ([`Rtt::set_blocking`]) and may fail to reset them.

/// First bytes of the control block.
const IDENTITY: &[u8; 16] = b"SEGGER RTT\0\0\0\0\0\0";
/// Offset of the first up channel in the control block, and length of a channel, bytes.
const CHANNEL: usize = 24;
const CHANNEL_LENGTH: usize = 24;
/// Value of a channel's flags with which the target waits for the host if the buffer is full.
const BLOCKING: u8 = 2;

/// The host's side of up channel 0.
#[derive(Clone, Debug)]
pub struct Rtt {
    /// First address of the target's memory that the host reads.
    base: u32,
    /// Address of the control block; `None` until a search has found it.
    block: Option<u32>,
    /// True if the address comes from a symbol: the memory is not searched.
    fixed: bool,
    reading: bool,
}

/// Fields of the channel.
#[derive(Clone, Copy)]
struct Channel {
    /// Offsets in the memory of the channel's fields and of the ring buffer.
    fields: usize,
    ring: usize,
    size: usize,
    write: usize,
    read: usize,
}

impl Rtt {
    /// Creates the host side for a memory that begins at `base`. `block` is the address of `_SEGGER_RTT`; without it,
    /// the memory is searched.
    pub fn new(base: u32, block: Option<u32>) -> Self {
        Self {
            base,
            block,
            fixed: block.is_some(),
            reading: true,
        }
    }

    /// Stops or resumes reading. The mode of the channel is unchanged.
    pub fn set_reading(&mut self, reading: bool) {
        self.reading = reading;
    }

    /// Reads all available bytes and appends them to `out`.
    pub fn poll(&mut self, memory: &mut [u8], out: &mut Vec<u8>) {
        let Some(channel) = self.channel(memory) else {
            return;
        };
        if !self.reading {
            return;
        }
        let Channel {
            fields,
            ring,
            size,
            write,
            read,
        } = channel;
        if write < read {
            out.extend_from_slice(&memory[ring + read..ring + size]);
            out.extend_from_slice(&memory[ring..ring + write]);
        } else {
            out.extend_from_slice(&memory[ring + read..ring + write]);
        }
        if write != read {
            memory[fields + 16..fields + 20].copy_from_slice(&(write as u32).to_le_bytes());
        }
    }

    /// Makes the target wait when the buffer is full, as a host does that starts to read.
    pub fn set_blocking(&mut self, memory: &mut [u8]) {
        if let Some(channel) = self.channel(memory) {
            let at = channel.fields + 20;
            memory[at] = memory[at] & !3 | BLOCKING;
        }
    }

    /// Sets the read offset so that the buffer is full, as a stalled host leaves it.
    pub fn leave_full(&mut self, memory: &mut [u8]) {
        if let Some(channel) = self.channel(memory) {
            let (at, next) = (channel.fields + 16, (channel.write + 1) % channel.size);
            memory[at..at + 4].copy_from_slice(&(next as u32).to_le_bytes());
        }
    }

    fn channel(&mut self, memory: &[u8]) -> Option<Channel> {
        let start = self.find(memory)?;
        let fields = start + CHANNEL;
        let field = |index: usize| word(memory, fields + 4 * index);
        let channel = Channel {
            fields,
            ring: field(1)?.wrapping_sub(self.base) as usize,
            size: field(2)? as usize,
            write: field(3)? as usize,
            read: field(4)? as usize,
        };
        let end = channel.ring.checked_add(channel.size)?;
        let channels = word(memory, start + 16)?;
        let sound = channels > 0
            && end <= memory.len()
            && fields + CHANNEL_LENGTH <= memory.len()
            && channel.write < channel.size
            && channel.read < channel.size;
        sound.then_some(channel)
    }

    /// Offset of the control block in the memory; `None` if the block is not there.
    fn find(&mut self, memory: &[u8]) -> Option<usize> {
        let is_there = |at: usize| memory.get(at..at + 16) == Some(&IDENTITY[..]);
        if let Some(block) = self.block {
            let at = block.wrapping_sub(self.base) as usize;
            if at < memory.len() && is_there(at) {
                return Some(at);
            }
            if self.fixed {
                return None;
            }
        }
        let at = (0..memory.len()).step_by(4).find(|&at| is_there(at))?;
        self.block = Some(self.base + at as u32);
        Some(at)
    }
}

fn word(memory: &[u8], at: usize) -> Option<u32> {
    let bytes = memory.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(bytes.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASE: u32 = 0x2000_0000;
    const BLOCK: usize = 0x40;
    const RING: usize = 0x100;
    const SIZE: usize = 16;

    /// The target side, according to the manual.
    struct Target {
        memory: Vec<u8>,
    }

    impl Target {
        fn new() -> Self {
            let mut target = Self {
                memory: vec![0xaa; 0x200],
            };
            target.memory[BLOCK..BLOCK + 16].copy_from_slice(IDENTITY);
            let words = [1, 0, 0, BASE + RING as u32, SIZE as u32, 0, 0, 0];
            for (at, word) in (BLOCK + 16..).step_by(4).zip(words) {
                target.set(at, word);
            }
            target
        }

        fn set(&mut self, at: usize, word: u32) {
            self.memory[at..at + 4].copy_from_slice(&word.to_le_bytes());
        }

        /// Writes the bytes that fit; returns their number.
        fn write(&mut self, bytes: &[u8]) -> usize {
            let (at, read) = (BLOCK + 36, word(&self.memory, BLOCK + 40).unwrap() as usize);
            for (k, &byte) in bytes.iter().enumerate() {
                let write = word(&self.memory, at).unwrap() as usize;
                let next = (write + 1) % SIZE;
                if next == read {
                    return k;
                }
                self.memory[RING + write] = byte;
                self.set(at, next as u32);
            }
            bytes.len()
        }
    }

    #[test]
    fn every_byte_arrives_once_and_in_order() {
        for block in [None, Some(BASE + BLOCK as u32)] {
            let mut target = Target::new();
            let mut rtt = Rtt::new(BASE, block);
            let sent: Vec<u8> = (0..=255).collect();
            let (mut out, mut done) = (Vec::new(), 0);
            for k in 1.. {
                let end = (done + k % 23).min(sent.len());
                done += target.write(&sent[done..end]);
                if k % 3 == 0 {
                    rtt.poll(&mut target.memory, &mut out);
                }
                if done == sent.len() {
                    break;
                }
            }
            rtt.poll(&mut target.memory, &mut out);
            assert_eq!(out, sent);
        }
    }

    #[test]
    fn buffer_fills_while_the_host_does_not_read() {
        let mut target = Target::new();
        let mut rtt = Rtt::new(BASE, None);
        let mut out = Vec::new();
        rtt.set_blocking(&mut target.memory);
        assert_eq!(word(&target.memory, BLOCK + 44), Some(2));
        rtt.set_reading(false);
        assert_eq!(target.write(&[7; 20]), SIZE - 1);
        rtt.poll(&mut target.memory, &mut out);
        assert_eq!((out.len(), target.write(&[7])), (0, 0));
        // The host stopped without resetting the mode.
        assert_eq!(word(&target.memory, BLOCK + 44), Some(2));
        rtt.set_reading(true);
        rtt.poll(&mut target.memory, &mut out);
        assert_eq!((out.len(), target.write(&[7])), (SIZE - 1, 1));
    }

    #[test]
    fn memory_without_a_valid_channel_is_unchanged() {
        let mut rtt = Rtt::new(BASE, None);
        let (mut memory, mut out) = (vec![0x55u8; 0x200], Vec::new());
        rtt.poll(&mut memory, &mut out);
        let (ring, size) = ((28, 0x2100_0000), (32, 0x8000_0000));
        for (offset, value) in [(16, 0), ring, size, (36, 16), (40, 99)] {
            let mut target = Target::new();
            target.set(BLOCK + offset, value);
            let before = target.memory.clone();
            rtt.poll(&mut target.memory, &mut out);
            assert!(target.memory == before && out.is_empty(), "{offset}");
        }
        // A control block at the very end of the memory.
        let mut end = vec![0; 0x200];
        end[0x1f0..].copy_from_slice(IDENTITY);
        rtt.poll(&mut end, &mut out);
        assert!(out.is_empty());
    }
}
