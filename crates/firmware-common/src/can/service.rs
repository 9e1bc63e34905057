//! Bus frames of the link ([`core_algos::link::segment`]), which bypass the nodes.

use core_algos::bus::CanFrame;
use core_algos::link::segment;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use static_cell::ConstStaticCell;

/// Size of the queue of arrived frames; each sending board sends one frame of the link per tick.
const ARRIVED: usize = 16;
/// Size of the queue of frames to be sent: the number of frames of the longest reply.
const SENDING: usize = 34;

type Frames<const N: usize> = Channel<CriticalSectionRawMutex, CanFrame, N>;

struct Channels {
    arrived: Frames<ARRIVED>,
    sending: Frames<SENDING>,
}

/// Splits the channels into their ends; call it once.
pub(super) fn split() -> (Incoming, Outgoing, ServicePort) {
    static CHANNELS: ConstStaticCell<Channels> = ConstStaticCell::new(Channels {
        arrived: Channel::new(),
        sending: Channel::new(),
    });
    let channels: &'static Channels = CHANNELS.take();
    (
        Incoming(&channels.arrived),
        Outgoing(&channels.sending),
        ServicePort(channels),
    )
}

/// The bus receiver's end: frames of the link that arrived.
pub(super) struct Incoming(&'static Frames<ARRIVED>);

impl Incoming {
    /// True if the frame belongs to the link, which then receives it. If the channel is full, the frame is lost and
    /// the host repeats its request.
    pub fn take(&mut self, frame: &CanFrame) -> bool {
        let service = segment::address(frame.id).is_some();
        if service {
            let _ = self.0.try_send(*frame);
        }
        service
    }
}

/// The bus sender's end: frames of the link to be sent.
pub(super) struct Outgoing(&'static Frames<SENDING>);

impl Outgoing {
    /// The next frame to be sent; `None` if none waits.
    pub fn next(&mut self) -> Option<CanFrame> {
        self.0.try_receive().ok()
    }
}

/// The link's end of both channels.
pub struct ServicePort(&'static Channels);

impl ServicePort {
    /// Waits for the next frame of the link.
    pub async fn receive(&mut self) -> CanFrame {
        self.0.arrived.receive().await
    }

    /// Queues frames, of which one is sent per tick. If the channel is full, frames are lost and the host repeats its
    /// request.
    pub fn send(&mut self, frames: impl Iterator<Item = CanFrame>) {
        for frame in frames {
            let _ = self.0.sending.try_send(frame);
        }
    }

    /// True if no frame waits to be sent.
    pub fn is_sent(&self) -> bool {
        self.0.sending.is_empty()
    }
}
