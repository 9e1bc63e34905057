//! Check of an MCAP file's lengths and checksums before a reader trusts them.
//!
//! Source: the MCAP format specification, sections Records, Data End, Footer and Chunk.

use crc32fast::Hasher;
use mcap::MAGIC;
use mcap::records::op;
use std::io::{self, Read, Seek, SeekFrom};

/// Iterator over records in memory: operation, position of the first byte, content; or an error for a truncated
/// record.
pub(super) struct Records<'a> {
    /// Bytes of the records.
    pub bytes: &'a [u8],
    /// Position of the next record.
    pub at: usize,
}

impl<'a> Iterator for Records<'a> {
    type Item = Result<(u8, usize, &'a [u8]), String>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.at;
        let rest = &self.bytes[at..];
        if rest.is_empty() {
            return None;
        }
        let content = rest.split_first_chunk::<9>().and_then(|(head, rest)| {
            let length = number(&head[1..]).and_then(|length| usize::try_from(length).ok())?;
            Some((head[0], at, rest.get(..length)?))
        });
        self.at = content.map_or(self.bytes.len(), |(_, _, content)| at + 9 + content.len());
        Some(content.ok_or_else(|| truncated(at)))
    }
}

fn truncated(at: impl std::fmt::Display) -> String {
    format!("truncated in the record at byte {at}")
}

fn number(bytes: &[u8]) -> Option<u64> {
    bytes.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
}

fn matches(given: Option<&[u8]>, sum: Option<u32>, of: &str) -> Result<(), String> {
    let given = given
        .and_then(|given| given.first_chunk())
        .map(|given| u32::from_le_bytes(*given));
    // Fuzzing accepts every checksum, because random input cannot match one.
    match cfg!(fuzzing) || given.is_some() && given == sum {
        true => Ok(()),
        false => Err(format!("damaged: the checksum of {of} does not match")),
    }
}

/// Rejects a record whose content is not `length` bytes long. This check is needed because no checksum covers the
/// length.
fn exactly(length: usize, content: &[u8], of: &str, at: u64) -> Result<(), String> {
    match content.len() == length {
        true => Ok(()),
        false => Err(format!(
            "damaged: {of} at byte {at} has {} bytes: must be {length}",
            content.len()
        )),
    }
}

/// Replaces `content` by the next `length` bytes of a file; false if the file ends earlier.
fn fill(content: &mut Vec<u8>, file: impl Read, length: u64) -> io::Result<bool> {
    content.clear();
    file.take(length).read_to_end(content)?;
    Ok(content.len() as u64 == length)
}

/// Rejects a file whose records do not fill it, or whose data or summary fail their checksums.
pub fn check(mut file: impl Read + Seek) -> Result<(), String> {
    let in_words = |error: io::Error| error.to_string();
    let mark = MAGIC.len() as u64;
    let size = file.seek(SeekFrom::End(0)).map_err(in_words)?;
    let end = size.saturating_sub(mark);
    let (mut head, mut content) = (Vec::new(), Vec::new());
    for place in [end, 0] {
        file.seek(SeekFrom::Start(place)).map_err(in_words)?;
        fill(&mut content, &mut file, mark).map_err(in_words)?;
        if size < 2 * mark || content != MAGIC {
            return Err(
                "not a complete MCAP file: first or last bytes are wrong; truncated, or another type of file"
                    .to_owned(),
            );
        }
    }
    let mut before = Hasher::new();
    before.update(MAGIC);
    let mut at = mark;
    let (mut data, mut summary) = (false, false);
    while at < end {
        let left = (end - at).checked_sub(9).ok_or_else(|| truncated(at))?;
        fill(&mut head, &mut file, 9).map_err(in_words)?;
        let length = head.get(1..).and_then(number);
        let length = length.filter(|length| *length <= left);
        let length = length.ok_or_else(|| truncated(at))?;
        if !fill(&mut content, &mut file, length).map_err(in_words)? {
            return Err(truncated(at));
        }
        match head[0] {
            op::CHUNK => check_chunk(&content)
                .map_err(|what| format!("{what}, in the chunk at byte {at}"))?,
            op::DATA_END => {
                exactly(4, &content, "DataEnd", at)?;
                let sum = before.clone().finalize();
                matches(Some(&content), Some(sum), "the data")?;
                data = true;
            }
            op::FOOTER => {
                exactly(20, &content, "Footer", at)?;
                let start = number(&content);
                let covered =
                    start.and_then(|start| Some((start, (at + 9 + 16).checked_sub(start)?)));
                let mut bytes = Vec::new();
                if let Some((start, length)) = covered {
                    file.seek(SeekFrom::Start(start)).map_err(in_words)?;
                    fill(&mut bytes, &mut file, length).map_err(in_words)?;
                    let next = SeekFrom::Start(at + 9 + 20);
                    file.seek(next).map_err(in_words)?;
                }
                let sum = covered.map(|_| crc32fast::hash(&bytes));
                matches(content.get(16..), sum, "the summary")?;
                summary = true;
            }
            _ => {}
        }
        before.update(&head);
        before.update(&content);
        at += 9 + length;
    }
    match data && summary {
        true => Ok(()),
        false => Err("the file is truncated".to_owned()),
    }
}

/// Rejects a chunk whose records do not fill it. For a compressed chunk the reader does this check.
fn check_chunk(content: &[u8]) -> Result<(), String> {
    // Bytes 0 to 27 hold start, end, size and checksum; bytes 28 to 31 hold the length of the compression's name, 0 if
    // the chunk is not compressed.
    let name = content.get(28..32).and_then(|name| name.first_chunk());
    let plain = name.ok_or("truncated")? == &[0; 4];
    let length = content.get(32..).and_then(number);
    let records = content
        .get(40..)
        .filter(|records| length == Some(records.len() as u64));
    match records {
        _ if !plain => Ok(()),
        Some(bytes) => Records { bytes, at: 0 }.try_for_each(|record| record.map(|_| ())),
        None => Err("truncated".to_owned()),
    }
}
