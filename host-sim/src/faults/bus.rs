//! What can happen to frames on their way.

/// A disturbance of the bus; all of it at once.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Disturbance {
    /// Probability that a receiver loses a frame.
    pub loss: f64,
    /// Added latency, ms.
    pub late_ms: u32,
    /// Largest latency added at random, frame by frame, ms: frames overtake each other.
    pub jitter_ms: u32,
    /// Probability that a frame arrives twice.
    pub doubling: f64,
    /// Probability that some bits of a frame change without its check sum showing it.
    pub corruption: f64,
    /// Frames of random content a node sends each ms.
    pub babble: u32,
}

impl Disturbance {
    const NONE: Self = Self {
        loss: 0.0,
        late_ms: 0,
        jitter_ms: 0,
        doubling: 0.0,
        corruption: 0.0,
        babble: 0,
    };

    /// A node that sends frames of the highest priority as fast as it can: what others send comes
    /// late or is given up.
    pub const BABBLE: Self = Self {
        loss: 0.3,
        late_ms: 3,
        babble: 5,
        ..Self::NONE
    };

    /// Loses frames.
    pub const fn loss(share: f64) -> Self {
        Self {
            loss: share,
            ..Self::NONE
        }
    }

    /// Delays all frames.
    pub const fn late(ms: u32) -> Self {
        Self {
            late_ms: ms,
            ..Self::NONE
        }
    }

    /// Delays each frame by another time.
    pub const fn jitter(ms: u32) -> Self {
        Self {
            jitter_ms: ms,
            ..Self::NONE
        }
    }

    /// Doubles frames.
    pub const fn doubling(share: f64) -> Self {
        Self {
            doubling: share,
            ..Self::NONE
        }
    }

    /// Changes bits.
    pub const fn corruption(share: f64) -> Self {
        Self {
            corruption: share,
            ..Self::NONE
        }
    }
}
