//! Entries of the board's tick on their way to a host that watches at the serial port.

use core::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, AtomicUsize, Ordering};

use core_algos::bus::CanFrame;
use core_algos::link::attendant::REPORT_ENTRIES;
use core_algos::link::record::{Entry, MAX_ENTRY};

/// Words that wait for the link: two epochs of all boards, twice over. A power of two.
const ROOM: usize = 512;

/// In place of a length: a frame that is not encoded.
const FRAME: u32 = 0xff;

static WATCHED: AtomicBool = AtomicBool::new(false);
static WANTED: AtomicBool = AtomicBool::new(false);
static LOST: AtomicU16 = AtomicU16::new(0);
/// Entries in whole words, each behind a byte with its length: from the word read to the word written.
static RING: [AtomicU32; ROOM] = [const { AtomicU32::new(0) }; ROOM];
static WRITTEN: AtomicUsize = AtomicUsize::new(0);
static READ: AtomicUsize = AtomicUsize::new(0);

/// Entries in a report, at most.
pub type Room = heapless::Vec<u8, REPORT_ENTRIES>;

/// Takes entries from here on.
pub fn watch() {
    WATCHED.store(true, Ordering::Relaxed);
}

/// True once a host watches.
pub fn is_watched() -> bool {
    WATCHED.load(Ordering::Relaxed)
}

/// Asks the tick to let the nodes begin anew.
pub fn begin() {
    WANTED.store(true, Ordering::Relaxed);
}

/// True once after [`begin`].
pub fn take_wanted() -> bool {
    WANTED.swap(false, Ordering::Relaxed)
}

/// Appends an entry, if a host watches. For the tick alone.
pub fn put(entry: &Entry) {
    if !is_watched() {
        return;
    }
    let mut room = [0; MAX_ENTRY + 4];
    let Some(length) = entry.encode(&mut room[1..]).map(<[u8]>::len) else {
        LOST.fetch_add(1, Ordering::Relaxed);
        return;
    };
    room[0] = length as u8;
    let (chunks, _) = room.as_chunks();
    append(
        chunks
            .iter()
            .take(words(length))
            .map(|word| u32::from_le_bytes(*word)),
    );
}

/// Appends a frame, if a host watches, to be encoded when it is taken. For the tick alone.
pub fn put_frame(frame: &CanFrame) {
    if is_watched() {
        let head = FRAME | u32::from(frame.length) << 8 | u32::from(frame.id) << 16;
        let [a, b, c, d, e, f, g, h] = frame.data;
        let data = [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes);
        append([head, data[0], data[1]].into_iter());
    }
}

/// Appends words, or none.
fn append(words: impl ExactSizeIterator<Item = u32>) {
    let written = WRITTEN.load(Ordering::Relaxed);
    let used = written.wrapping_sub(READ.load(Ordering::Acquire));
    let count = words.len();
    if ROOM - used < count {
        LOST.fetch_add(1, Ordering::Relaxed);
        return;
    }
    for (k, word) in words.enumerate() {
        RING[written.wrapping_add(k) % ROOM].store(word, Ordering::Relaxed);
    }
    WRITTEN.store(written.wrapping_add(count), Ordering::Release);
}

/// Words of an entry and its length.
const fn words(length: usize) -> usize {
    (length + 4) / 4
}

/// Entries that found no room, modulo 65 536.
pub fn lost() -> u16 {
    LOST.load(Ordering::Relaxed)
}

/// The end where entries are taken out.
#[derive(Default)]
pub struct Taker {
    /// An entry waits that did not fit.
    behind: bool,
}

impl Taker {
    /// True if an entry waits that did not fit.
    pub fn is_behind(&self) -> bool {
        self.behind
    }

    /// The oldest entries that fit into `most` bytes.
    pub fn take(&mut self, most: usize) -> Room {
        let mut room = Room::new();
        self.behind = false;
        loop {
            let read = READ.load(Ordering::Relaxed);
            if read == WRITTEN.load(Ordering::Acquire) {
                return room;
            }
            let word = |k: usize| RING[read.wrapping_add(k) % ROOM].load(Ordering::Relaxed);
            let mut entry = [0; MAX_ENTRY + 4];
            let (bytes, count) = match word(0) & 0xff {
                FRAME => (frame(&mut entry, [word(0), word(1), word(2)]), 3),
                length => {
                    let length = length as usize;
                    let (chunks, _) = entry.as_chunks_mut();
                    for (k, chunk) in chunks.iter_mut().take(words(length)).enumerate() {
                        *chunk = word(k).to_le_bytes();
                    }
                    (&entry[1..=length], words(length))
                }
            };
            self.behind = room.len() + bytes.len() > most;
            if self.behind || room.extend_from_slice(bytes).is_err() {
                return room;
            }
            READ.store(read.wrapping_add(count), Ordering::Release);
        }
    }
}

/// Encodes a frame.
fn frame(room: &mut [u8], [head, low, high]: [u32; 3]) -> &[u8] {
    let mut data = [0; 8];
    data[..4].copy_from_slice(&low.to_le_bytes());
    data[4..].copy_from_slice(&high.to_le_bytes());
    let frame = CanFrame {
        id: (head >> 16) as u16,
        length: (head >> 8) as u8,
        data,
    };
    Entry::of(&frame).encode(room).unwrap_or_default()
}
