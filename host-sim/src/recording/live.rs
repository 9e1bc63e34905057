//! A run served by websocket while it goes: the topics of a log, to viewers such as Foxglove.
//!
//! The server is in builds with the feature `live` only, for it doubles what has to be built.

use crate::base::error::Error;
use std::net::{Ipv4Addr, SocketAddr};

#[cfg_attr(feature = "live", path = "live/server.rs")]
#[cfg_attr(not(feature = "live"), path = "live/absent.rs")]
mod server;

pub use server::Server;

/// Address of the server: an address with a port, or a port of this machine alone.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let local = || {
        text.parse()
            .map(|port: u16| (Ipv4Addr::LOCALHOST, port).into())
    };
    text.parse().or_else(|_| local()).map_err(|_| {
        "must be ADDRESS:PORT or a port, for example 8765 for viewers on this machine or \
         0.0.0.0:8765 for others too"
            .to_owned()
    })
}

/// An error if this program cannot serve.
pub fn check() -> Result<(), Error> {
    match cfg!(feature = "live") {
        true => Ok(()),
        false => Err(Error::input(
            "--live: this program was built without it: cargo run --release --package host-sim \
             --features live -- posture --live",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_port_and_a_port_alone_is_this_machine() {
        let text = |text| address(text).map(|address| address.to_string());
        assert_eq!(text("0.0.0.0:8765").as_deref(), Ok("0.0.0.0:8765"));
        assert_eq!(text("[::1]:80").as_deref(), Ok("[::1]:80"));
        assert_eq!(text("9000").as_deref(), Ok("127.0.0.1:9000"));
        for bad in ["", "localhost", "1.2.3.4", "65536", "1.2.3.4:x", "-1"] {
            assert!(address(bad).unwrap_err().contains("0.0.0.0:8765"), "{bad}");
        }
    }
}
