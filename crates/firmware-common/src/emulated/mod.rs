//! What QEMU needs beyond hardware in the loop, and nothing else; see `docs/emulation.md`.

mod instruction;
mod shadow;

#[cfg(target_os = "none")]
mod flash;
#[cfg(target_os = "none")]
mod options;
#[cfg(target_os = "none")]
mod pipe;
#[cfg(target_os = "none")]
mod run;
#[cfg(target_os = "none")]
pub(crate) mod shim;
#[cfg(target_os = "none")]
mod uart;

#[cfg(target_os = "none")]
pub use run::run;

/// Ends the emulation because the host has closed its end of the link.
#[cfg(target_os = "none")]
fn host_gone() -> ! {
    defmt::info!("the host has closed the link");
    semihosting::process::exit(0)
}
