//! The CAN bus between boards.
