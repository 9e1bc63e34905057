//! Registers as gdb numbers them, by the target description below.

use crate::core::Core;
use gdbstub::arch::{Arch, Registers};
use std::fmt::Write;
use std::sync::OnceLock;

/// A Cortex-M4F.
#[derive(Debug)]
pub enum CortexM4F {}

impl Arch for CortexM4F {
    type Usize = u32;
    type Registers = CoreRegisters;
    type BreakpointKind = usize;
    type RegId = ();

    fn target_description_xml() -> Option<&'static str> {
        static TEXT: OnceLock<String> = OnceLock::new();
        Some(TEXT.get_or_init(description))
    }
}

/// Registers in the order of their numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoreRegisters {
    /// r0 to r12, sp, lr, pc, xpsr.
    pub core: [u32; 17],
    /// s0 to s31, as d0 to d15.
    pub single: [u32; 32],
    /// fpscr, msp, psp: gdb changes the first alone.
    pub special: [u32; 3],
    /// primask, basepri, faultmask, control; gdb cannot change them.
    pub masks: [u8; 4],
}

impl CoreRegisters {
    /// As they are.
    pub fn of(core: &Core) -> Self {
        Self {
            core: std::array::from_fn(|n| match n {
                16 => core.xpsr(),
                n => core.register(n),
            }),
            single: std::array::from_fn(|n| core.single(n)),
            special: [core.fpscr(), core.msp(), core.psp()],
            masks: core.masks().to_le_bytes(),
        }
    }

    /// Sets those that differ.
    pub fn set(&self, core: &mut Core) {
        let old = Self::of(core);
        for (n, (&new, old)) in self.core.iter().zip(old.core).enumerate() {
            match n {
                _ if new == old => {}
                16 => core.set_xpsr(new),
                n => core.set_register(n, new),
            }
        }
        for (n, &bits) in self.single.iter().enumerate() {
            core.set_single(n, bits);
        }
        core.set_fpscr(self.special[0]);
    }

    fn words(&mut self) -> impl Iterator<Item = &mut u32> {
        let Self {
            core,
            single,
            special,
            ..
        } = self;
        core.iter_mut().chain(single).chain(special)
    }
}

impl Registers for CoreRegisters {
    type ProgramCounter = u32;

    fn pc(&self) -> u32 {
        self.core[15]
    }

    fn gdb_serialize(&self, mut write_byte: impl FnMut(Option<u8>)) {
        let words = self
            .clone()
            .words()
            .flat_map(|w| w.to_le_bytes())
            .collect::<Vec<_>>();
        for byte in words.into_iter().chain(self.masks) {
            write_byte(Some(byte));
        }
    }

    fn gdb_deserialize(&mut self, bytes: &[u8]) -> Result<(), ()> {
        let (words, masks) = bytes.split_last_chunk::<4>().ok_or(())?;
        let (chunks, rest) = words.as_chunks::<4>();
        let mut count = 0;
        for (word, chunk) in self.words().zip(chunks) {
            *word = u32::from_le_bytes(*chunk);
            count += 1;
        }
        self.masks = *masks;
        let whole = count == 52 && chunks.len() == 52 && rest.is_empty();
        if whole { Ok(()) } else { Err(()) }
    }
}

/// The target description: names, widths, order.
fn description() -> String {
    let mut text = String::from(
        r#"<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target version="1.0">
<architecture>arm</architecture>
<feature name="org.gnu.gdb.arm.m-profile">
"#,
    );
    let mut register = |name: &str, bits: u32, kind: &str| {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            r#"<reg name="{name}" bitsize="{bits}" type="{kind}"/>"#
        );
    };
    for n in 0..13 {
        register(&format!("r{n}"), 32, "uint32");
    }
    register("sp", 32, "data_ptr");
    register("lr", 32, "uint32");
    register("pc", 32, "code_ptr");
    register("xpsr", 32, "uint32");
    text += "</feature>\n<feature name=\"org.gnu.gdb.arm.vfp\">\n";
    for n in 0..16 {
        let _ = writeln!(
            text,
            r#"<reg name="d{n}" bitsize="64" type="ieee_double"/>"#
        );
    }
    text += "<reg name=\"fpscr\" bitsize=\"32\" type=\"uint32\" group=\"float\"/>\n</feature>\n";
    text += "<feature name=\"org.gnu.gdb.arm.m-system\">\n";
    for (name, bits, kind) in [
        ("msp", 32, "data_ptr"),
        ("psp", 32, "data_ptr"),
        ("primask", 8, "uint8"),
        ("basepri", 8, "uint8"),
        ("faultmask", 8, "uint8"),
        ("control", 8, "uint8"),
    ] {
        let _ = writeln!(
            text,
            r#"<reg name="{name}" bitsize="{bits}" type="{kind}"/>"#
        );
    }
    text += "</feature>\n</target>\n";
    text
}
