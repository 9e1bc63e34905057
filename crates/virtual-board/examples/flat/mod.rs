//! A chip that consists only of memories: flash at 0x0800_0000 and at 0, RAM at 0x2000_0000 and 0x1000_0000.

#[allow(dead_code)]
pub mod peer;
#[allow(dead_code)]
pub mod semihosting;

use virtual_board::core::{BusError, Core, System, Transfer, Width};
use virtual_board::image::Image;
use virtual_board::{Cycles, FindingKind};

/// A chip that consists only of memories.
pub struct Flat {
    pub flash: Vec<u8>,
    pub sram: Vec<u8>,
    pub ccm: Vec<u8>,
    until: Cycles,
    changed: Option<(u32, u32)>,
    pub notes: Vec<String>,
}

impl Default for Flat {
    fn default() -> Self {
        Self {
            flash: vec![0xff; 1 << 20],
            sram: vec![0; 0x2_0000],
            ccm: vec![0; 0x1_0000],
            until: 0,
            changed: None,
            notes: Vec::new(),
        }
    }
}

impl Flat {
    #[inline]
    fn place(&mut self, address: u32, width: Width) -> Option<&mut [u8]> {
        let (memory, offset) = match address >> 24 {
            0x20 => (&mut self.sram, address & 0xff_ffff),
            0x08 | 0x00 => (&mut self.flash, address & 0xff_ffff),
            0x10 => (&mut self.ccm, address & 0xff_ffff),
            _ => return None,
        };
        let offset = offset as usize;
        memory.get_mut(offset..offset + width.bytes() as usize)
    }

    /// A core ready to run an image, with a debugger attached.
    #[allow(dead_code)]
    pub fn start(image: &Image) -> (Core, Self) {
        let mut flat = Self::default();
        image.load(&mut flat.flash);
        let mut core = Core::new();
        core.attach_debugger(true);
        core.reset(&mut flat);
        (core, flat)
    }

    /// Writes code or data into the flash.
    pub fn program(&mut self, offset: usize, bytes: &[u8]) {
        self.flash[offset..offset + bytes.len()].copy_from_slice(bytes);
        let first = 0x0800_0000 + offset as u32;
        self.changed = Some((first, first + bytes.len() as u32 - 1));
    }
}

impl System for Flat {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        let place = self.place(address, Width::Half).ok_or(BusError)?;
        Ok(u16::from_le_bytes([place[0], place[1]]))
    }

    fn enter_line(&mut self, _address: u32, _cycle: &mut Cycles) {}

    #[inline]
    fn read(&mut self, at: Transfer, _cycle: &mut Cycles) -> Result<u32, BusError> {
        let place = self.place(at.address, at.width).ok_or(BusError)?;
        Ok(match *place {
            [a] => u32::from(a),
            [a, b] => u32::from(u16::from_le_bytes([a, b])),
            [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
            _ => 0,
        })
    }

    #[inline]
    fn write(&mut self, at: Transfer, value: u32, _cycle: &mut Cycles) -> Result<(), BusError> {
        if at.address >> 24 != 0x20 && at.address >> 24 != 0x10 {
            return Err(BusError);
        }
        let place = self.place(at.address, at.width).ok_or(BusError)?;
        match place {
            [a] => *a = value as u8,
            [a, b] => [*a, *b] = (value as u16).to_le_bytes(),
            [a, b, c, d] => [*a, *b, *c, *d] = value.to_le_bytes(),
            _ => {}
        }
        Ok(())
    }

    #[inline]
    fn limit(&self) -> Cycles {
        self.until
    }

    fn advance(&mut self, _cycle: Cycles, until: Cycles) -> Cycles {
        self.until = until;
        until
    }

    fn lines(&self) -> u128 {
        0
    }

    fn take_changed_code(&mut self) -> Option<(u32, u32)> {
        self.changed.take()
    }

    fn request_reset(&mut self) {}

    fn note(&mut self, kind: FindingKind, pc: u32, _cycle: Cycles, text: String) {
        self.notes
            .push(format!("{pc:#010x}: {}: {text}", kind.name()));
    }
}
