//! What the emulator's command line says: role of the board, and link.
//!
//! QEMU joins every `arg=` of `-semihosting-config` with blanks, for example
//! `role=front link=pipe in=/run/a out=/run/b`.

use core::ffi::CStr;
use core::mem::MaybeUninit;

use semihosting::sys::arm_compat::sys_get_cmdline_uninit;

/// Room for the whole command line, two paths included.
const ROOM: usize = 1024;

/// The command line.
pub struct Options {
    text: heapless::String<ROOM>,
}

/// A file name in the form the emulator takes.
pub struct Path([u8; 512]);

impl Path {
    /// The name up to its terminating zero.
    pub fn as_c_str(&self) -> &CStr {
        // The last byte is never written, so there is a zero.
        CStr::from_bytes_until_nul(&self.0).unwrap_or_default()
    }
}

impl Options {
    /// Asks the emulator; without a command line it is empty.
    pub fn read() -> Self {
        let mut buffer = [MaybeUninit::uninit(); ROOM];
        let line = sys_get_cmdline_uninit(&mut buffer).ok();
        let text = line.and_then(|line| core::str::from_utf8(line).ok());
        Self {
            text: text
                .and_then(|text| text.try_into().ok())
                .unwrap_or_default(),
        }
    }

    /// The value of `name=value`, if the word is there.
    pub fn get(&self, name: &str) -> Option<&str> {
        let words = self.text.split([' ', '\0']);
        words
            .filter_map(|word| word.split_once('='))
            .find(|(key, _)| *key == name)
            .map(|(_, value)| value)
    }

    /// The value as a file name; `None` also if it is too long.
    pub fn path(&self, name: &str) -> Option<Path> {
        let value = self.get(name)?.as_bytes();
        let mut path = Path([0; 512]);
        let (_, room) = path.0.split_last_mut()?;
        room.get_mut(..value.len())?.copy_from_slice(value);
        Some(path)
    }
}
