//! Bus frames of the link ([`core_algos::link::segment`]): they pass by the nodes.

use core_algos::bus::CanFrame;
use core_algos::link::segment;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;

/// Frames that wait for the link; a board sends one a tick.
const TO_TAKE: usize = 16;
/// Frames that wait to be sent: those of the longest reply.
const TO_SEND: usize = 34;

type Frames<const N: usize> = Channel<CriticalSectionRawMutex, CanFrame, N>;
static ARRIVED: Frames<TO_TAKE> = Channel::new();
static SENDING: Frames<TO_SEND> = Channel::new();

/// True if the frame is one of the link, which takes it. Without room it is lost, and the host repeats its request.
pub(super) fn takes(frame: &CanFrame) -> bool {
    let service = segment::address(frame.id).is_some();
    if service {
        let _ = ARRIVED.try_send(*frame);
    }
    service
}

/// Waits for the next frame.
pub async fn receive() -> CanFrame {
    ARRIVED.receive().await
}

/// Frames to be sent, at most one a tick. Without room they are lost, and the host repeats its request.
pub fn send(frames: impl Iterator<Item = CanFrame>) {
    for frame in frames {
        let _ = SENDING.try_send(frame);
    }
}

/// The next frame to be sent.
pub(super) fn next() -> Option<CanFrame> {
    SENDING.try_receive().ok()
}

/// True if no frame waits to be sent.
pub fn is_sent() -> bool {
    SENDING.is_empty()
}
