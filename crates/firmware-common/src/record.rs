//! Queue of log entries from the board's tick to a host that watches at the serial port.
//!
//! [`Ring::split`] returns the tick's end, which appends entries, and the link's end, which takes them.

use core::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, AtomicUsize, Ordering};

use core_algos::bus::CanFrame;
use core_algos::link::record::{Entry, MAX_ENTRY};
use core_algos::link::run_link::REPORT_ENTRIES;

/// Capacity in words: twice what all boards write in two epochs. A power of two.
const CAPACITY: usize = 512;

/// Value of the length byte that marks an unencoded frame.
const FRAME: u32 = 0xff;

/// Encoded log entries of one report.
pub type Entries = heapless::Vec<u8, REPORT_ENTRIES>;

/// Queue of entries, each in whole words after a byte with its length.
pub struct Ring {
    /// True once a host watches.
    watched: AtomicBool,
    /// Entries lost because the ring was full, modulo 65 536.
    lost: AtomicU16,
    words: [AtomicU32; CAPACITY],
    /// Words written and read since the start, modulo 2³².
    written: AtomicUsize,
    read: AtomicUsize,
}

impl Ring {
    /// Empty ring, not watched.
    pub const fn new() -> Self {
        Self {
            watched: AtomicBool::new(false),
            lost: AtomicU16::new(0),
            words: [const { AtomicU32::new(0) }; CAPACITY],
            written: AtomicUsize::new(0),
            read: AtomicUsize::new(0),
        }
    }

    /// Splits the ring into the tick's end and the link's end.
    pub fn split(&'static mut self) -> (Recorder, Reader) {
        let reader = Reader {
            ring: self,
            behind: false,
        };
        (Recorder(reader.ring), reader)
    }
}

/// The tick's end of the ring. The bus and the nodes have a clone each; all clones belong to one task, the only writer.
#[derive(Clone)]
pub struct Recorder(&'static Ring);

impl Recorder {
    /// True once a host watches.
    pub fn is_watched(&self) -> bool {
        self.0.watched.load(Ordering::Relaxed)
    }

    /// Appends an entry, if a host watches.
    pub fn put(&mut self, entry: &Entry) {
        if self.is_watched() {
            self.encode(entry);
        }
    }

    /// Not inlined, so that an unwatched tick costs only the check.
    #[inline(never)]
    fn encode(&mut self, entry: &Entry) {
        let mut room = [0; MAX_ENTRY + 4];
        let Some(length) = entry.encode(&mut room[1..]).map(<[u8]>::len) else {
            self.0.lost.fetch_add(1, Ordering::Relaxed);
            return;
        };
        room[0] = length as u8;
        let (chunks, _) = room.as_chunks();
        self.append(
            chunks
                .iter()
                .take(words(length))
                .map(|word| u32::from_le_bytes(*word)),
        );
    }

    /// Appends a frame, if a host watches; the frame is encoded when it is taken.
    pub fn put_frame(&mut self, frame: &CanFrame) {
        if self.is_watched() {
            let head = FRAME | u32::from(frame.length) << 8 | u32::from(frame.id) << 16;
            let [a, b, c, d, e, f, g, h] = frame.data;
            let data = [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes);
            self.append([head, data[0], data[1]].into_iter());
        }
    }

    /// Appends all words; if the ring has no room for all, appends none and counts one loss.
    fn append(&mut self, words: impl ExactSizeIterator<Item = u32>) {
        let ring = self.0;
        let written = ring.written.load(Ordering::Relaxed);
        let used = written.wrapping_sub(ring.read.load(Ordering::Acquire));
        let count = words.len();
        if CAPACITY - used < count {
            ring.lost.fetch_add(1, Ordering::Relaxed);
            return;
        }
        for (k, word) in words.enumerate() {
            ring.words[written.wrapping_add(k) % CAPACITY].store(word, Ordering::Relaxed);
        }
        ring.written
            .store(written.wrapping_add(count), Ordering::Release);
    }
}

/// Number of words of an entry of `length` bytes and its length byte.
const fn words(length: usize) -> usize {
    (length + 4) / 4
}

/// The link's end of the ring.
pub struct Reader {
    ring: &'static Ring,
    /// True if the next entry did not fit into the last report.
    behind: bool,
}

impl Reader {
    /// Starts the recording of entries.
    pub fn watch(&mut self) {
        self.ring.watched.store(true, Ordering::Relaxed);
    }

    /// True once a host watches.
    pub fn is_watched(&self) -> bool {
        self.ring.watched.load(Ordering::Relaxed)
    }

    /// Entries lost because the ring was full, modulo 65 536.
    pub fn lost(&self) -> u16 {
        self.ring.lost.load(Ordering::Relaxed)
    }

    /// True if the next entry did not fit into the last report.
    pub fn is_behind(&self) -> bool {
        self.behind
    }

    /// Takes the oldest entries that fit into `max_bytes` bytes.
    pub fn take(&mut self, max_bytes: usize) -> Entries {
        let ring = self.ring;
        let mut entries = Entries::new();
        self.behind = false;
        loop {
            let read = ring.read.load(Ordering::Relaxed);
            if read == ring.written.load(Ordering::Acquire) {
                return entries;
            }
            let word =
                |k: usize| ring.words[read.wrapping_add(k) % CAPACITY].load(Ordering::Relaxed);
            let mut entry = [0; MAX_ENTRY + 4];
            let (bytes, count) = match word(0) & 0xff {
                FRAME => (frame(&mut entry, [word(0), word(1), word(2)]), 3),
                length => {
                    let length = length as usize;
                    let (chunks, _) = entry.as_chunks_mut();
                    for (k, chunk) in chunks.iter_mut().take(words(length)).enumerate() {
                        *chunk = word(k).to_le_bytes();
                    }
                    (entry.get(1..=length).unwrap_or_default(), words(length))
                }
            };
            self.behind = entries.len() + bytes.len() > max_bytes;
            if self.behind || entries.extend_from_slice(bytes).is_err() {
                return entries;
            }
            ring.read.store(read.wrapping_add(count), Ordering::Release);
        }
    }
}

/// Encodes the bus frame that three words of the ring hold.
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

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::link::Order;
    use core_algos::link::record::entries;
    use core_algos::node::lead::Task;

    fn ends() -> (Recorder, Reader) {
        Box::leak(Box::new(Ring::new())).split()
    }

    fn frame_of(k: u16) -> CanFrame {
        let [low, high] = k.to_le_bytes();
        CanFrame {
            id: k % 0x700,
            length: (k % 9) as u8,
            data: [low, high, 1, 2, 3, 4, 5, 6],
        }
    }

    /// Appends the `k`-th entry, of varying length; returns its text.
    fn put(recorder: &mut Recorder, k: u16) -> String {
        let frame = frame_of(k);
        let entry = match k % 4 {
            0 => Entry::Carried(k),
            1 => Entry::Begin { tick: k.into() },
            2 => Entry::Order(Order::Task(Task::Drive {
                speed_m_s: k.into(),
                curvature: 0.5,
            })),
            _ => {
                recorder.put_frame(&frame);
                return format!("{:?}", Entry::of(&frame));
            }
        };
        recorder.put(&entry);
        format!("{entry:?}")
    }

    fn texts(bytes: &[u8]) -> impl Iterator<Item = String> {
        entries(bytes).map(|entry| format!("{:?}", entry.expect("a whole entry")))
    }

    /// Takes all entries that wait.
    fn rest(reader: &mut Reader) -> Vec<String> {
        let mut rest = Vec::new();
        loop {
            let entries = reader.take(REPORT_ENTRIES);
            if entries.is_empty() {
                return rest;
            }
            rest.extend(texts(&entries));
        }
    }

    #[test]
    fn entries_are_taken_whole_and_in_order() {
        let (mut recorder, mut reader) = ends();
        reader.watch();
        let (mut written, mut taken) = (Vec::new(), Vec::new());
        for k in 0..20_000 {
            written.push(put(&mut recorder, k));
            // The limit varies, so that some entries do not fit.
            if k % 5 == 0 {
                let max_bytes = REPORT_ENTRIES - usize::from(k % 40);
                let entries = reader.take(max_bytes);
                assert!(entries.len() <= max_bytes);
                taken.extend(texts(&entries));
            }
        }
        taken.extend(rest(&mut reader));
        assert_eq!(reader.lost(), 0);
        assert_eq!(taken, written);
    }

    #[test]
    fn full_ring_counts_lost_entries_and_tears_none() {
        let (mut recorder, mut reader) = ends();
        reader.watch();
        let (mut kept, mut taken, mut lost) = (Vec::new(), Vec::new(), 0);
        for k in 0..20_000 {
            let before = reader.lost();
            let text = put(&mut recorder, k);
            match reader.lost() == before {
                true => kept.push(text),
                false => lost += 1,
            }
            // Entries are taken more slowly than they are appended.
            if k % 40 == 0 {
                taken.extend(texts(&reader.take(REPORT_ENTRIES)));
            }
        }
        taken.extend(rest(&mut reader));
        assert!(lost > 1_000 && kept.len() > 1_000, "{lost} lost");
        assert_eq!(reader.lost(), lost);
        assert_eq!(taken, kept);
    }

    #[test]
    fn entry_that_does_not_fit_waits() {
        let (mut recorder, mut reader) = ends();
        reader.watch();
        let text = put(&mut recorder, 2);
        assert!(!reader.is_behind());
        assert!(reader.take(3).is_empty());
        assert!(reader.is_behind());
        assert!(texts(&reader.take(REPORT_ENTRIES)).eq([text]));
        assert!(!reader.is_behind());
    }

    #[test]
    fn nothing_is_recorded_before_a_host_watches() {
        let (mut recorder, mut reader) = ends();
        put(&mut recorder, 0);
        put(&mut recorder, 3);
        reader.watch();
        assert!(reader.take(REPORT_ENTRIES).is_empty());
        let text = put(&mut recorder, 3);
        assert!(texts(&reader.take(REPORT_ENTRIES)).eq([text]));
    }
}
