//! Recovery of a truncated log: every complete record goes into a new, complete file.

use super::intact::Records;
use crate::entry::{ABOUT, END};
use host_sim::run::end::EndKind;
use mcap::records::{MessageHeader, Metadata, Record, op};
use mcap::{MAGIC, McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// Length of the head of an uncompressed chunk, bytes.
const CHUNK_HEAD: usize = 40;

/// Summary of a recovered log.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Number of messages recovered.
    pub messages: u64,
    /// Time of the latest message, ns.
    pub last_ns: u64,
    /// Missing and omitted parts of the log.
    pub missing: Vec<String>,
}

/// Writes the complete records of a log into a new log. An error is the reason why nothing can be recovered.
pub fn recover(bytes: &[u8], to: impl Write + Seek) -> Result<Recovered, String> {
    if !bytes.starts_with(MAGIC) {
        return Err("not an MCAP file: its first bytes are wrong".to_owned());
    }
    let options = WriteOptions::new().compression(None).profile("cfmmr");
    let writer = options.create(to).map_err(in_words)?;
    let mut copy = LogCopy {
        writer,
        found: Recovered::default(),
        metadata: BTreeMap::new(),
    };
    copy.file(bytes)?;
    copy.finish()
}

fn in_words(error: McapError) -> String {
    error.to_string()
}

/// True if the checksum at position `at` of a record matches `bytes`; a checksum of 0 means none.
fn checksum_of(record: &[u8], at: usize, bytes: &[u8]) -> bool {
    let sum = record.get(at..).and_then(|sum| sum.first_chunk());
    let sum = sum.map(|sum| u32::from_le_bytes(*sum));
    sum.is_some_and(|sum| sum == 0 || sum == crc32fast::hash(bytes))
}

/// Copy of a log being written.
struct LogCopy<W: Write + Seek> {
    writer: Writer<W>,
    found: Recovered,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
}

impl<W: Write + Seek> LogCopy<W> {
    /// Copies the records of a file.
    fn file(&mut self, bytes: &[u8]) -> Result<(), String> {
        let mut records = Records {
            bytes,
            at: MAGIC.len(),
        };
        loop {
            let at = records.at;
            match records.next() {
                Some(Ok((op::DATA_END, ..))) => {
                    if !bytes.ends_with(MAGIC) {
                        self.note_missing("the index at the end of the file".to_owned());
                    }
                    return Ok(());
                }
                Some(Ok((op::CHUNK, at, content))) => self.chunk(at, content)?,
                Some(Ok((operation, _, content))) => self.record(operation, content)?,
                Some(Err(_)) if bytes.get(at) == Some(&op::CHUNK) => {
                    // The head of an unfinished chunk has no length and no checksum, so the chunk's records are read
                    // one by one.
                    let inner = bytes.get(at + 9 + CHUNK_HEAD..).unwrap_or_default();
                    self.records(inner)?;
                    self.note_missing(format!("the chunk at byte {at} is cut off"));
                    return Ok(());
                }
                Some(Err(_)) => {
                    self.note_missing(format!("the record at byte {at} is cut off"));
                    return Ok(());
                }
                None => {
                    self.note_missing("the end of the file".to_owned());
                    return Ok(());
                }
            }
        }
    }

    fn note_missing(&mut self, what: String) {
        self.found.missing.push(what);
    }

    /// Copies a complete chunk, unless it is damaged or compressed.
    fn chunk(&mut self, at: usize, content: &[u8]) -> Result<(), String> {
        let plain = content.get(28..32) == Some(&[0; 4]);
        let inner = content.get(CHUNK_HEAD..).filter(|_| plain);
        let Some(inner) = inner.filter(|inner| checksum_of(content, 24, inner)) else {
            self.note_missing(format!(
                "the chunk at byte {at}, which is damaged or compressed"
            ));
            return Ok(());
        };
        self.records(inner)
    }

    fn records(&mut self, bytes: &[u8]) -> Result<(), String> {
        let whole = Records { bytes, at: 0 }.map_while(Result::ok);
        for (operation, _, content) in whole {
            self.record(operation, content)?;
        }
        Ok(())
    }

    /// Copies a record; a record that does not decode is left out.
    fn record(&mut self, operation: u8, content: &[u8]) -> Result<(), String> {
        let Ok(record) = mcap::read::parse_record(operation, content) else {
            self.note_missing("a record that does not decode".to_owned());
            return Ok(());
        };
        let added = match record {
            Record::Schema { header, data } => {
                let (name, encoding) = (&header.name, &header.encoding);
                self.writer
                    .add_schema_with_id(header.id, name, encoding, &data)
            }
            Record::Channel(of) => self.writer.add_channel_with_id(
                of.id,
                of.schema_id,
                &of.topic,
                &of.message_encoding,
                &of.metadata,
            ),
            Record::Message { header, data } => return self.message(&header, &data),
            Record::Metadata(metadata) => {
                self.metadata.insert(metadata.name, metadata.metadata);
                return Ok(());
            }
            _ => return Ok(()),
        };
        // Adding a channel fails if its schema was in a lost chunk.
        if let Err(error) = added {
            self.note_missing(format!("a channel: {error}"));
        }
        Ok(())
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), String> {
        match self.writer.write_to_known_channel(header, data) {
            Ok(()) => {
                self.found.messages += 1;
                self.found.last_ns = self.found.last_ns.max(header.log_time);
                Ok(())
            }
            // The channel of this message was in a lost chunk.
            Err(McapError::UnknownChannel(..)) => {
                self.note_missing(format!(
                    "a message at {:.3} s of a lost channel",
                    header.log_time as f64 * 1e-9
                ));
                Ok(())
            }
            Err(error) => Err(in_words(error)),
        }
    }

    fn finish(mut self) -> Result<Recovered, String> {
        for name in [ABOUT, END] {
            if !self.metadata.contains_key(name) {
                self.note_missing(format!("the metadata record {name}"));
            }
        }
        if !self.metadata.contains_key(END) {
            let entries = [("kind", EndKind::Interrupted.name()), ("whole", "false")];
            let entries = entries.map(|(key, value)| (key.to_owned(), value.to_owned()));
            self.metadata.insert(END.to_owned(), entries.into());
        }
        for (name, metadata) in self.metadata {
            let metadata = Metadata { name, metadata };
            self.writer.write_metadata(&metadata).map_err(in_words)?;
        }
        self.writer.finish().map_err(in_words)?;
        Ok(self.found)
    }
}

#[cfg(test)]
mod tests {
    use super::super::read;
    use super::super::replay::tests::{compare, recorded};
    use super::*;
    use std::io::Cursor;

    fn recovered(bytes: &[u8]) -> (Recovered, Vec<u8>) {
        let mut copy = Cursor::new(Vec::new());
        let found = recover(bytes, &mut copy).unwrap();
        (found, copy.into_inner())
    }

    #[test]
    fn complete_log_is_recovered_unchanged() {
        let log = recorded(1200, |_| ());
        let (found, copy) = recovered(&log);
        assert_eq!(found.missing, Vec::<String>::new());
        let (before, after) = (
            read::read(&log, "log").unwrap(),
            read::read(&copy, "copy").unwrap(),
        );
        assert_eq!(before, after);
        assert_eq!(recovered(&copy).1, copy);
    }

    /// Cuts a log at five places. Each copy holds the log's events up to the cut, except at most two per board, and
    /// replays without a difference.
    #[test]
    fn log_truncated_anywhere_keeps_its_complete_records() {
        let log = recorded(1200, |_| ());
        let whole = read::read(&log, "log").unwrap();
        let mut last = 0;
        for share in [0.3, 0.5, 0.7, 0.9, 0.999] {
            let cut = &log[..(log.len() as f64 * share) as usize];
            assert!(read::read(cut, "cut").is_err());
            let (found, copy) = recovered(cut);
            assert!(!found.missing.is_empty());
            let read = read::read(&copy, "copy").unwrap();
            for (part, all) in read.boards.iter().zip(&whole.boards) {
                // The log may be cut before an output of the lead node that belongs to the last events.
                let kept = part.len().saturating_sub(2);
                assert_eq!(part[..kept], all[..kept]);
            }
            assert!(read.ticks() >= last);
            last = read.ticks();
            assert!(compare(&read.boards).unwrap().is_none(), "{share}");
        }
        assert!(last + 5 >= whole.ticks(), "{last} of {}", whole.ticks());
    }

    #[test]
    fn damaged_chunk_is_left_out_and_named() {
        let mut log = recorded(1200, |_| ());
        let middle = log.len() / 2;
        log[middle] ^= 1;
        let (found, copy) = recovered(&log);
        assert!(found.missing[0].contains("damaged"), "{found:?}");
        super::super::intact::check(Cursor::new(&copy)).unwrap();
        assert!(recover(b"not a log", Cursor::new(Vec::new())).is_err());
        assert!(recover(&[], Cursor::new(Vec::new())).is_err());
    }
}
