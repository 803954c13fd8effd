//! Validity of a motion in a packet to a driver's worker, which makes the robot stand when it ends.

use crate::time::Span;

/// Time for which a robot's motion stays valid after a packet. When it ends, the driver's worker makes the robot stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// The validity stays as before, because the packet moves nothing.
    Keep,
    /// The robot stands, or is not commanded: the validity has no end.
    Standing,
    /// The validity is this long, counted from the arrival of the packet at the worker.
    For(Span),
}

impl Hold {
    /// Returns the validity as the eight bytes of a packet.
    pub fn to_bytes(self) -> [u8; 8] {
        let ns = match self {
            Hold::Keep => u64::MAX,
            Hold::Standing => 0,
            // Zero would mean standing.
            Hold::For(span) => span.as_nanos().clamp(1, u64::MAX - 1),
        };
        ns.to_le_bytes()
    }

    /// Reads the validity from the eight bytes of a packet.
    pub fn from_bytes(bytes: [u8; 8]) -> Hold {
        match u64::from_le_bytes(bytes) {
            u64::MAX => Hold::Keep,
            0 => Hold::Standing,
            ns => Hold::For(Span::from_nanos(ns)),
        }
    }
}
