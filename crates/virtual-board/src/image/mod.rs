//! An image: the ELF file that a debug probe writes into the flash.
//!
//! [`Image::parse`] checks everything that execution relies on; an error names the field, its value and the allowed
//! values. Symbols and debug information are optional: without them, functions or source lines are unknown.

mod lines;

pub use lines::SourceLine;

use lines::Lines;
use object::LittleEndian;
use object::elf::{EM_ARM, ET_EXEC, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};
use std::collections::HashMap;
use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::sync::OnceLock;

/// Address range of the flash of the STM32F405xG.
pub const FLASH: Range<u32> = 0x0800_0000..0x0810_0000;
/// Address range of SRAM1 and SRAM2.
pub const SRAM: Range<u32> = 0x2000_0000..0x2002_0000;
/// Address range of the core-coupled memory.
pub const CCM: Range<u32> = 0x1000_0000..0x1001_0000;

/// Number of vectors: 16 of the core, 82 interrupts of the chip.
const VECTORS: usize = 98;

/// Reason why a file is not an image for this chip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageError {
    /// Name of the file.
    pub file: String,
    /// Name of the invalid field.
    pub field: &'static str,
    /// Value of the field.
    pub value: String,
    /// Allowed values of the field.
    pub allowed: &'static str,
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            file,
            field,
            value,
            allowed,
        } = self;
        write!(f, "{file}: {field} is {value}: must be {allowed}")
    }
}

impl std::error::Error for ImageError {}

/// Content of a part of the flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segment {
    /// First address of the segment.
    pub address: u32,
    /// Bytes of the segment.
    pub data: Vec<u8>,
}

impl Segment {
    fn contains(&self, address: u32) -> bool {
        let place = address.wrapping_sub(self.address);
        (place as usize) < self.data.len()
    }
}

/// A function or a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Name as in the source, without hash.
    pub name: String,
    /// First address (for a function, without the Thumb bit).
    pub address: u32,
    /// Length, bytes; 0 if unknown.
    pub size: u32,
}

/// An image.
#[derive(Debug)]
pub struct Image {
    bytes: Vec<u8>,
    segments: Vec<Segment>,
    /// Functions in the order of their addresses.
    functions: Vec<Symbol>,
    /// Address and length of each symbol; the key is its name in the file or its readable name.
    names: HashMap<String, (u32, u32)>,
    lines: OnceLock<Lines>,
}

impl Image {
    /// Reads an ELF file and checks its content; an error names the file.
    pub fn open(path: &Path) -> Result<Self, ImageError> {
        let file = path.display().to_string();
        match std::fs::read(path) {
            Ok(bytes) => Self::parse(&file, bytes),
            Err(error) => Err(ImageError {
                file,
                field: "the file",
                value: format!("not readable ({error})"),
                allowed: "a readable ELF file",
            }),
        }
    }

    /// Checks the content of a file; `file` is the name for errors.
    pub fn parse(file: &str, bytes: Vec<u8>) -> Result<Self, ImageError> {
        Self::check(bytes).map_err(|(field, value, allowed)| ImageError {
            file: file.to_owned(),
            field,
            value,
            allowed,
        })
    }

    fn check(bytes: Vec<u8>) -> Result<Self, Wrong> {
        check_header(&bytes)?;
        let elf = ElfFile32::<LittleEndian>::parse(&*bytes).map_err(|e| cut(e, &bytes))?;
        let segments = segments(&elf, &bytes)?;
        vectors(&segments)?;
        let (functions, names) = symbols(&elf);
        Ok(Self {
            segments,
            functions,
            names,
            lines: OnceLock::new(),
            bytes,
        })
    }

    /// The whole file, for readers of further sections, such as the log's format strings.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Segments to be written to the flash.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Writes the segments to a flash whose first byte has the first address of [`FLASH`].
    pub fn load(&self, flash: &mut [u8]) {
        for segment in &self.segments {
            let start = (segment.address - FLASH.start) as usize;
            if let Some(bytes) = flash.get_mut(start..start + segment.data.len()) {
                bytes.copy_from_slice(&segment.data);
            }
        }
    }

    /// Address of a function or variable, by its name in the file or in the source; `None` if the name is unknown.
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.names.get(name).map(|s| s.0)
    }

    /// Function that contains an address; `None` if unknown.
    pub fn function(&self, pc: u32) -> Option<&Symbol> {
        let pc = pc & !1;
        let after = self.functions.partition_point(|s| s.address <= pc);
        let symbol = self.functions.get(after.checked_sub(1)?)?;
        // A function of unknown length extends to the next one.
        (symbol.size == 0 || pc - symbol.address < symbol.size).then_some(symbol)
    }

    /// Exceptions with their own handlers, and the names of the handlers. The vector shared by most interrupts is
    /// excluded.
    pub fn handlers(&self) -> Vec<(u16, String)> {
        let flash = self.segments.iter().find(|s| s.address == FLASH.start);
        let words = flash.map_or(&[][..], |s| s.data.as_chunks::<4>().0);
        let vectors = words
            .iter()
            .take(VECTORS)
            .map(|word| u32::from_le_bytes(*word));
        let vectors: Vec<u32> = vectors.collect();
        let times = |vector| vectors.iter().filter(|&&v| v == vector).count();
        let shared = vectors.iter().copied().max_by_key(|&vector| times(vector));
        let own = (0u16..).zip(&vectors).skip(2).filter(|&(_, vector)| {
            let code = self.segments.iter().any(|s| s.contains(vector & !1));
            code && vector & 1 != 0 && Some(*vector) != shared
        });
        own.map(|(number, &vector)| {
            let symbol = self.function(vector);
            let name = symbol.map_or_else(|| format!("exception {number}"), |s| s.name.clone());
            (number, name)
        })
        .collect()
    }

    /// Source line of an address; for inlined functions, the innermost. `None` if unknown.
    pub fn line(&self, pc: u32) -> Option<SourceLine<'_>> {
        self.lines().find(pc & !1)
    }

    /// Text for an address: function and source line, as far as known.
    pub fn describe(&self, pc: u32) -> String {
        let mut text = format!("{pc:#010x}");
        if let Some(symbol) = self.function(pc) {
            text += &format!(" {}+{:#x}", symbol.name, (pc & !1) - symbol.address);
        }
        if let Some(place) = self.line(pc) {
            text += &format!(" ({place})");
        }
        text
    }

    /// Raw bytes of a section; `None` for an unknown section and for a section without content in the file.
    pub fn section(&self, name: &str) -> Option<&[u8]> {
        let elf = ElfFile32::<LittleEndian>::parse(&*self.bytes).ok()?;
        let (start, length) = elf.section_by_name(name)?.file_range()?;
        let start = usize::try_from(start).ok()?;
        let length = usize::try_from(length).ok()?;
        self.bytes.get(start..start.checked_add(length)?)
    }

    fn lines(&self) -> &Lines {
        self.lines.get_or_init(|| {
            let section = |name: &str| self.section(name).unwrap_or_default();
            Lines::read(section, |pc| self.segments.iter().any(|s| s.contains(pc)))
        })
    }
}

/// Field, value and allowed values of an [`ImageError`].
type Wrong = (&'static str, String, &'static str);

fn cut(error: object::Error, bytes: &[u8]) -> Wrong {
    let value = format!("damaged or cut ({error}, {} bytes)", bytes.len());
    ("the file", value, "a whole ELF file")
}

/// Checks that the file is a linked program for a 32-bit Arm.
fn check_header(bytes: &[u8]) -> Result<(), Wrong> {
    if bytes.is_empty() {
        return Err(("the file", "empty".into(), "an ELF file"));
    }
    if !bytes.starts_with(b"\x7fELF") {
        let first = bytes.iter().take(4).map(|b| format!("{b:02x}"));
        let value = first.collect::<Vec<_>>().join(" ");
        return Err(("its beginning", value, "7f 45 4c 46 (ELF)"));
    }
    if bytes.len() < 52 {
        let value = format!("{} bytes long", bytes.len());
        return Err(("the file", value, "a whole ELF file"));
    }
    let byte = |at: usize| u16::from(bytes[at]);
    let half = |at: usize| byte(at) | byte(at + 1) << 8;
    for (field, value, right, allowed) in [
        ("its class", byte(4), 1, "1 (32 bits)"),
        ("its data encoding", byte(5), 1, "1 (little endian)"),
        ("its machine", half(18), EM_ARM, "40 (Arm)"),
        ("its type", half(16), ET_EXEC, "2 (a linked program)"),
    ] {
        if value != right {
            return Err((field, value.to_string(), allowed));
        }
    }
    Ok(())
}

fn segments(elf: &ElfFile32<'_, LittleEndian>, bytes: &[u8]) -> Result<Vec<Segment>, Wrong> {
    let endian = LittleEndian;
    let headers = elf.elf_header().program_headers(endian, bytes);
    let headers = headers.map_err(|e| cut(e, bytes))?;
    let mut segments = Vec::new();
    for (number, header) in headers.iter().enumerate() {
        if header.p_type(endian) != PT_LOAD || header.p_filesz(endian) == 0 {
            continue;
        }
        let (address, length) = (header.p_paddr(endian), header.p_filesz(endian));
        let Ok(data) = header.data(endian, bytes) else {
            let place = header.p_offset(endian);
            let value = format!(
                "{length} bytes at {place} of {} (number {number})",
                bytes.len()
            );
            return Err(("a segment", value, "within the file, which is truncated"));
        };
        let end = u64::from(address) + u64::from(length);
        if address < FLASH.start || end > u64::from(FLASH.end) {
            return Err((
                "a segment's physical address",
                format!("{address:#010x} to {end:#010x} (number {number})"),
                "within the flash of the STM32F405 (0x08000000 to 0x08100000)",
            ));
        }
        segments.push(Segment {
            address,
            data: data.to_vec(),
        });
    }
    segments.sort_by_key(|s| s.address);
    if segments.is_empty() {
        let nothing = "without anything to load".into();
        return Err(("the file", nothing, "a linked program"));
    }
    Ok(segments)
}

/// Checks the initial stack pointer and the reset vector.
fn vectors(segments: &[Segment]) -> Result<(), Wrong> {
    let first = segments
        .iter()
        .find(|s| s.address == FLASH.start)
        .map_or(&[][..], |s| &s.data);
    let Some((&[a, b, c, d, e, f, g, h], _)) = first.split_first_chunk::<8>() else {
        let begin = segments.first().map_or(0, |s| s.address);
        let value = format!("missing: the image begins at {begin:#010x}");
        return Err(("the vector table", value, "at 0x08000000"));
    };
    let sp = u32::from_le_bytes([a, b, c, d]);
    let reset = u32::from_le_bytes([e, f, g, h]);
    // The stack grows down from its first address, which may be the end of the memory.
    let in_memory = [SRAM, CCM].iter().any(|m| sp > m.start && sp <= m.end);
    if !in_memory || sp % 4 != 0 {
        return Err((
            "the initial stack pointer",
            format!("{sp:#010x}"),
            "in the STM32F405's memory (up to 0x20020000, or 0x10010000), a multiple of 4",
        ));
    }
    if reset % 2 == 0 || !segments.iter().any(|s| s.contains(reset & !1)) {
        return Err((
            "the reset vector",
            format!("{reset:#010x}"),
            "an odd address (Thumb) within the image",
        ));
    }
    Ok(())
}

type Names = HashMap<String, (u32, u32)>;

fn symbols(elf: &ElfFile32<'_, LittleEndian>) -> (Vec<Symbol>, Names) {
    let (mut functions, mut names) = (Vec::new(), Names::new());
    for symbol in elf.symbols() {
        let Ok(raw) = symbol.name() else { continue };
        // `$t`, `$d` and similar symbols mark code and data.
        if raw.is_empty() || raw.starts_with('$') || symbol.is_undefined() {
            continue;
        }
        let is_function = symbol.kind() == SymbolKind::Text;
        let thumb = u32::from(is_function);
        let address = symbol.address() as u32 & !thumb;
        let size = symbol.size() as u32;
        let name = format!("{:#}", rustc_demangle::demangle(raw));
        names.entry(raw.to_owned()).or_insert((address, size));
        names.entry(name.clone()).or_insert((address, size));
        if is_function {
            functions.push(Symbol {
                name,
                address,
                size,
            });
        }
    }
    functions.sort_by(|a, b| (a.address, &a.name).cmp(&(b.address, &b.name)));
    (functions, names)
}

#[cfg(test)]
pub(crate) mod tests;
