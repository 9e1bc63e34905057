//! Start of an emulated board.

use core_algos::hil::Identity;
use core_algos::topology::Role;
use embassy_stm32::Peripherals;

use super::flash;
use super::options::Options;
use super::pipe::Pipe;
use super::uart::Uart;
use crate::hil::{Kind, serve};
use crate::watchdog::Watchdog;

/// Runs the board's nodes behind the link that the command line names, for ever. `build` says what
/// the image was built from.
pub async fn run(p: Peripherals, kind: Kind, build: &'static str) -> ! {
    let watchdog = Watchdog::start();
    let options = Options::read();
    let role = match (kind, options.get("role")) {
        (Kind::Axle, Some("front")) => Role::Front,
        (Kind::Axle, Some("rear")) => Role::Rear,
        (Kind::Beam, Some("beam") | None) => Role::Beam,
        _ => refuse("role= must be front or rear for an axle, beam for the beam"),
    };
    let identity = Identity { build, role };
    let Some(store) = flash::open(&options) else {
        refuse("flash= must name a file of the flash's size")
    };
    match options.get("link") {
        Some("pipe") => match Pipe::open(&options) {
            Some(pipe) => serve(pipe, watchdog, identity, store).await,
            None => refuse("in= and out= must name two pipes"),
        },
        Some("uart") => {
            let link = Uart::new(p.USART2, p.PA3, p.PA2, p.USART3, p.PB11, p.PB10);
            serve(
                link.expect("the rate is fixed and fits"),
                watchdog,
                identity,
                store,
            )
            .await
        }
        _ => refuse("link= must be pipe or uart"),
    }
}

/// Ends the emulation because of a wrong command line.
fn refuse(reason: &str) -> ! {
    defmt::error!("command line: {}", reason);
    semihosting::process::exit(2)
}
