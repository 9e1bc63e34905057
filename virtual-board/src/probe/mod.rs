//! What a debug probe would see.
