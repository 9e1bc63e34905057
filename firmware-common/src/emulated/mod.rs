//! What QEMU needs beyond hardware in the loop, and nothing else; see `docs/emulation.md`.

pub mod options;
pub mod pipe;
pub mod shim;

/// Ends the emulation because of a wrong command line.
pub fn refuse(reason: &str) -> ! {
    defmt::error!("command line: {}", reason);
    semihosting::process::exit(2)
}

/// Ends the emulation because the host has closed its end of the link.
pub fn host_gone() -> ! {
    defmt::info!("the host has closed the link");
    semihosting::process::exit(0)
}
