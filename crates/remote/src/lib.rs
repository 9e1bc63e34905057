//! Boards outside of the simulation: real boards on serial ports, virtual boards with the images that users flash.
//!
//! | module | holds |
//! |---|---|
//! | [`link`], [`serial`], [`virtual_link`] | byte links of a session: interface, serial port, virtual board |
//! | [`board`] | a board behind such a link, as a [`Target`](host_sim::targets::Target) of the simulation |
//! | [`board_link`], [`serial_robot`] | a whole robot, driven through the port of its front board |
//! | [`virtual_robot`] | a whole robot of virtual boards; catalogue of faults for virtual and in-process boards |
//! | [`images`], [`board_log`] | the boards' images, built if needed; their logs |
//! | [`interrupt`] | detection of Ctrl-C and of a closed terminal or pipe |

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
