//! Lengths and checksums of an MCAP file, checked before a reader trusts them.
//!
//! Source: the MCAP format specification, sections Records, Data End, Footer and Chunk.

use mcap::MAGIC;
use mcap::records::op;

/// Records of a part of a file: operation, place of the first byte, content; or the fault of the next.
pub(super) struct Records<'a> {
    /// The part.
    pub bytes: &'a [u8],
    /// Place of the next record.
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
        Some(content.ok_or_else(|| format!("truncated in the record at byte {at}")))
    }
}

fn number(bytes: &[u8]) -> Option<u64> {
    bytes.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
}

fn matches(sum: Option<&[u8]>, bytes: Option<&[u8]>, of: &str) -> Result<(), String> {
    let given = sum
        .and_then(|sum| sum.first_chunk())
        .map(|sum| u32::from_le_bytes(*sum));
    // A fuzzer would not get past it.
    match cfg!(fuzzing) || given.is_some() && given == bytes.map(crc32fast::hash) {
        true => Ok(()),
        false => Err(format!("damaged: the checksum of {of} does not match")),
    }
}

/// Refuses a record of another length, which no checksum covers.
fn exactly(length: usize, content: &[u8], of: &str, at: usize) -> Result<(), String> {
    match content.len() == length {
        true => Ok(()),
        false => Err(format!(
            "damaged: {of} at byte {at} has {} bytes: must be {length}",
            content.len()
        )),
    }
}

/// Refuses a file whose records do not fill it, or whose data or summary do not match their checksums.
pub fn check(bytes: &[u8]) -> Result<(), String> {
    let body = bytes
        .strip_suffix(MAGIC)
        .filter(|body| body.starts_with(MAGIC));
    let body = body.ok_or(
        "not a complete MCAP file: first or last bytes are wrong; truncated, or another type of file",
    )?;
    let at = MAGIC.len();
    let (mut data, mut summary) = (false, false);
    for record in (Records { bytes: body, at }) {
        let (operation, at, content) = record?;
        match operation {
            op::CHUNK => {
                check_chunk(content).map_err(|what| format!("{what}, in the chunk at byte {at}"))?
            }
            op::DATA_END => {
                exactly(4, content, "DataEnd", at)?;
                matches(Some(content), Some(&body[..at]), "the data")?;
                data = true;
            }
            op::FOOTER => {
                exactly(20, content, "Footer", at)?;
                let start = number(content).and_then(|start| usize::try_from(start).ok());
                let covered = start.and_then(|start| body.get(start..at + 9 + 16));
                matches(content.get(16..), covered, "the summary")?;
                summary = true;
            }
            _ => {}
        }
    }
    match data && summary {
        true => Ok(()),
        false => Err("the file is truncated".to_owned()),
    }
}

/// Refuses a chunk whose records do not fill it; those of a compressed one are left to the reader.
fn check_chunk(content: &[u8]) -> Result<(), String> {
    // Start, end, size and checksum, then the name of the compression.
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
