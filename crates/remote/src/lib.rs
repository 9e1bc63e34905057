//! Boards outside of the simulation: real boards on serial ports, virtual boards with the images that users flash.
//!
//! | module | holds |
//! |---|---|
//! | [`link`], [`serial`], [`virtual_link`] | bytes of a session: interface, serial port, virtual board |
//! | [`board`] | a board behind such a link, as a [`Target`](host_sim::targets::Target) of the simulation |
//! | [`board_link`], [`serial_robot`] | a whole robot, driven through the port of its front board |
//! | [`virtual_robot`] | a whole robot of virtual boards; catalogue of faults, of boards in this process too |
//! | [`images`], [`board_log`] | the boards' images, built if needed; their logs |
//! | [`interrupt`] | Ctrl-C, and a terminal or pipe that is closed |

pub mod board;
pub mod board_link;
pub mod board_log;
pub mod images;
pub mod interrupt;
pub mod link;
pub mod log_reader;
pub mod parameters;
pub mod relay;
pub mod serial;
pub mod serial_line;
pub mod serial_robot;
pub mod unanswered;
pub mod virtual_link;
pub mod virtual_robot;

pub use board::Remote;
