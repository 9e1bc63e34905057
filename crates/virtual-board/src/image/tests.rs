//! Images built by hand and with another writer of debug information.

use super::*;
use gimli::write::{
    Address, AttributeValue, Dwarf as WriteDwarf, EndianVec, LineProgram, LineString, Sections,
    Unit,
};
use gimli::{Encoding, Format, LineEncoding};

/// Parts of an ELF file, from which the file is built.
#[derive(Clone)]
pub(crate) struct Builder {
    /// Physical address, virtual address, content.
    pub segments: Vec<(u32, u32, Vec<u8>)>,
    /// Name, address, size, true for a function.
    pub symbols: Vec<(String, u32, u32, bool)>,
    /// Name, content.
    pub sections: Vec<(String, Vec<u8>)>,
}

impl Builder {
    /// Vectors, then `code` at 0x08000100; the stack pointer is at the end of the SRAM.
    pub fn new(code: &[u8]) -> Self {
        let mut flash = vec![0xff; 0x100];
        flash[..4].copy_from_slice(&0x2002_0000u32.to_le_bytes());
        flash[4..8].copy_from_slice(&0x0800_0101u32.to_le_bytes());
        flash.extend_from_slice(code);
        Self {
            segments: vec![(0x0800_0000, 0x0800_0000, flash)],
            symbols: Vec::new(),
            sections: Vec::new(),
        }
    }

    pub fn function(mut self, name: &str, address: u32, size: u32) -> Self {
        self.symbols.push((name.into(), address | 1, size, true));
        self
    }

    pub fn variable(mut self, name: &str, address: u32, size: u32) -> Self {
        self.symbols.push((name.into(), address, size, false));
        self
    }

    /// Adds a line table (DWARF 5, by gimli's writer) with rows of address, file and line; `end` is the address at
    /// which the code of the last row ends.
    pub fn lines(mut self, rows: &[(u32, &str, u64)], end: u32) -> Self {
        let encoding = Encoding {
            address_size: 4,
            format: Format::Dwarf32,
            version: 5,
        };
        let root = b"/source".to_vec();
        let first = LineString::String(b"main.rs".to_vec());
        let directory = LineString::String(root.clone());
        let mut program =
            LineProgram::new(encoding, LineEncoding::default(), directory, first, None);
        let base = program.default_directory();
        program.begin_sequence(Some(Address::Constant(rows[0].0.into())));
        for &(address, file, line) in rows {
            let file = LineString::String(file.as_bytes().to_vec());
            let file = program.add_file(file, base, None);
            let row = program.row();
            row.file = file;
            row.line = line;
            row.address_offset = u64::from(address - rows[0].0);
            program.generate_row();
        }
        program.end_sequence(u64::from(end - rows[0].0));
        let mut dwarf = WriteDwarf::default();
        let unit = dwarf.units.add(Unit::new(encoding, program));
        let unit = dwarf.units.get_mut(unit);
        let entry = unit.root();
        let directory = AttributeValue::String(root);
        unit.get_mut(entry).set(gimli::DW_AT_comp_dir, directory);
        let mut sections = Sections::new(EndianVec::new(gimli::LittleEndian));
        dwarf.write(&mut sections).unwrap();
        sections
            .for_each(|id, data| -> Result<(), ()> {
                if !data.slice().is_empty() {
                    self.sections
                        .push((id.name().into(), data.slice().to_vec()));
                }
                Ok(())
            })
            .unwrap();
        self
    }

    pub fn build(&self) -> Vec<u8> {
        let mut file = vec![0u8; 52 + 32 * self.segments.len()];
        let mut headers = vec![[0u32; 10]];
        let mut names = vec![0u8];
        let mut name = |text: &str| {
            let at = names.len() as u32;
            names.extend_from_slice(text.as_bytes());
            names.push(0);
            at
        };
        for (k, (physical, virt, data)) in self.segments.iter().enumerate() {
            let length = data.len() as u32;
            let fields = [1, file.len() as u32, *virt, *physical, length, length, 5, 4];
            put(&mut file, 52 + 32 * k, &fields);
            file.extend_from_slice(data);
        }
        for (title, data) in &self.sections {
            let place = [file.len() as u32, data.len() as u32];
            headers.push([name(title), 1, 0, 0, place[0], place[1], 0, 0, 1, 0]);
            file.extend_from_slice(data);
        }
        if !self.symbols.is_empty() {
            let (mut table, mut strings) = (vec![0u8; 16], vec![0u8]);
            for (title, address, size, function) in &self.symbols {
                let at = strings.len() as u32;
                strings.extend_from_slice(title.as_bytes());
                strings.push(0);
                // Global function or object, in section 1 whatever its kind.
                let info = if *function { 0x12 } else { 0x11 } | 1 << 16;
                for field in [at, *address, *size, info] {
                    table.extend_from_slice(&field.to_le_bytes());
                }
            }
            let index = headers.len() as u32;
            let place = [file.len() as u32, table.len() as u32];
            let [at, length] = place;
            headers.push([name(".symtab"), 2, 0, 0, at, length, index + 1, 1, 4, 16]);
            file.extend_from_slice(&table);
            let place = [file.len() as u32, strings.len() as u32];
            headers.push([name(".strtab"), 3, 0, 0, place[0], place[1], 0, 0, 1, 0]);
            file.extend_from_slice(&strings);
        }
        let title = name(".shstrtab");
        let place = [file.len() as u32, names.len() as u32];
        headers.push([title, 3, 0, 0, place[0], place[1], 0, 0, 1, 0]);
        file.extend_from_slice(&names);
        let table = file.len() as u32;
        for header in &headers {
            for field in header {
                file.extend_from_slice(&field.to_le_bytes());
            }
        }
        file[..7].copy_from_slice(b"\x7fELF\x01\x01\x01");
        let counts = [
            0x0028_0002,
            1,
            0x0800_0101,
            52,
            table,
            0x0500_0400,
            0x0020_0034,
        ];
        put(&mut file, 16, &counts);
        let last = [
            self.segments.len() as u16,
            40,
            headers.len() as u16,
            headers.len() as u16 - 1,
        ];
        for (k, field) in last.iter().enumerate() {
            file[44 + 2 * k..46 + 2 * k].copy_from_slice(&field.to_le_bytes());
        }
        file
    }

    pub fn image(&self) -> Image {
        Image::parse("test.elf", self.build()).unwrap()
    }
}

fn put(file: &mut [u8], at: usize, words: &[u32]) {
    for (k, word) in words.iter().enumerate() {
        file[at + 4 * k..at + 4 * k + 4].copy_from_slice(&word.to_le_bytes());
    }
}

const CODE: [u8; 64] = [0; 64];

fn error(bytes: Vec<u8>) -> String {
    Image::parse("x.elf", bytes).unwrap_err().to_string()
}

#[test]
fn segments_are_loaded_at_their_physical_addresses() {
    let mut builder = Builder::new(&CODE);
    // Initial values of variables: stored behind the code, to be copied to the SRAM by the program.
    builder
        .segments
        .push((0x0801_0000, 0x2000_0000, vec![1, 2, 3]));
    let image = builder.image();
    let mut flash = vec![0xff; 1 << 20];
    image.load(&mut flash);
    assert_eq!(flash[..8], [0, 0, 2, 0x20, 1, 1, 0, 8]);
    assert_eq!(flash[0x1_0000..0x1_0004], [1, 2, 3, 0xff]);
}

#[test]
fn image_without_symbols_and_lines_is_accepted() {
    let image = Builder::new(&CODE).image();
    assert_eq!(image.describe(0x0800_0110), "0x08000110");
    assert_eq!(image.symbol("main"), None);
}

#[test]
fn functions_and_variables_are_found_by_name_and_address() {
    let image = Builder::new(&CODE)
        .function(
            "_ZN4core3fmt5Write9write_fmt17h0123456789abcdefE",
            0x0800_0110,
            16,
        )
        .function("main", 0x0800_0100, 0x10)
        .function("endless", 0x0800_0130, 0)
        .variable("_SEGGER_RTT", 0x2000_0010, 48)
        .image();
    for (pc, name) in [
        (0x0800_0101, Some("main")),
        (0x0800_010e, Some("main")),
        (0x0800_0110, Some("core::fmt::Write::write_fmt")),
        (0x0800_0120, None),
        (0x0800_013c, Some("endless")),
        (0x0800_00fe, None),
    ] {
        let found = image.function(pc).map(|symbol| symbol.name.as_str());
        assert_eq!(found, name, "{pc:#x}");
    }
    assert_eq!(image.symbol("_SEGGER_RTT"), Some(0x2000_0010));
    let readable = image.symbol("core::fmt::Write::write_fmt");
    assert_eq!(readable, Some(0x0800_0110));
    assert_eq!(image.describe(0x0800_0105), "0x08000105 main+0x4");
}

#[test]
fn source_lines_match_the_table() {
    let rows = [
        (0x0800_0100, "main.rs", 10),
        (0x0800_0104, "lib/inlined.rs", 77),
        (0x0800_0108, "main.rs", 0),
        (0x0800_010c, "main.rs", 12),
    ];
    let image = Builder::new(&CODE).lines(&rows, 0x0800_0110).image();
    // Line 0 is no source line; addresses beyond the end of the sequence have no line.
    for (pc, line) in [
        (0x0800_0103, Some("/source/main.rs:10")),
        (0x0800_0104, Some("/source/lib/inlined.rs:77")),
        (0x0800_0108, None),
        (0x0800_010e, Some("/source/main.rs:12")),
        (0x0800_0110, None),
    ] {
        let found = image.line(pc).map(|place| place.to_string());
        assert_eq!(found.as_deref(), line, "{pc:#x}");
    }
}

#[test]
fn lines_of_removed_code_are_omitted() {
    let image = Builder::new(&CODE).lines(&[(0, "gone.rs", 3)], 64).image();
    assert!(image.line(0).is_none());
}

#[test]
fn section_returns_raw_bytes() {
    let mut builder = Builder::new(&CODE);
    builder.sections.push((".defmt".into(), vec![7, 8, 9]));
    let image = builder.image();
    assert_eq!(image.section(".defmt"), Some(&[7u8, 8, 9][..]));
    assert_eq!(image.section(".nothing"), None);
}

#[test]
fn invalid_file_is_rejected_with_field_and_value() {
    let good = Builder::new(&CODE).build();
    let with = |at: usize, bytes: &[u8]| {
        let mut file = good.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        error(file)
    };
    for (found, expected) in [
        (error(Vec::new()), "the file is empty: must be an ELF file"),
        (
            error(b"#!/bin/sh\n".to_vec()),
            "its beginning is 23 21 2f 62: must be 7f 45 4c 46 (ELF)",
        ),
        (with(4, &[2]), "its class is 2: must be 1 (32 bits)"),
        (with(18, &[62]), "its machine is 62: must be 40 (Arm)"),
        (
            with(16, &[1]),
            "its type is 1: must be 2 (a linked program)",
        ),
        (
            error(good[..15].to_vec()),
            "the file is 15 bytes long: must be a whole ELF file",
        ),
    ] {
        assert_eq!(found, format!("x.elf: {expected}"));
    }
    // A file cut before the end of its segment is an error; a later cut may lose only the names of sections.
    let vectors_end = 52 + 32 + 0x100 + CODE.len();
    for length in 0..vectors_end {
        let cut = Image::parse("x", good[..length].to_vec());
        assert!(cut.is_err(), "{length}");
    }
}

#[test]
fn image_for_another_chip_is_rejected() {
    let change = |at: usize, value: u32| {
        let mut builder = Builder::new(&CODE);
        builder.segments[0].2[at..at + 4].copy_from_slice(&value.to_le_bytes());
        error(builder.build())
    };
    // The stack pointer is that of a chip with 192 KiB of contiguous memory, or in no memory; the reset vector is in
    // Arm state or outside the image.
    for (at, value, text) in [
        (0, 0x2003_0000, "the initial stack pointer is 0x20030000"),
        (0, 0x0000_0000, "the initial stack pointer is 0x00000000"),
        (4, 0x0800_0100, "the reset vector is 0x08000100"),
        (4, 0x0900_0101, "the reset vector is 0x09000101"),
    ] {
        assert!(change(at, value).contains(text), "{text}");
    }
    for (address, text) in [
        (0x0800_4000, "the vector table is missing"),
        (0x1000_0000, "physical address is 0x10000000 to 0x10000140"),
        (0x080f_fff0, "0x080ffff0 to 0x08100130"),
        (0xffff_fff0, "0xfffffff0 to 0x100000130"),
    ] {
        let mut builder = Builder::new(&CODE);
        builder.segments[0].0 = address;
        assert!(error(builder.build()).contains(text), "{text}");
    }
    let empty = Builder {
        segments: Vec::new(),
        ..Builder::new(&CODE)
    };
    assert!(error(empty.build()).contains("without anything to load"));
}
