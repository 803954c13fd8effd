//! Endpoint of a protocol at one station, and the time constants of a case, emulated or measured.

use crate::time::{Span, Time};

/// Warm-up before anything is counted: hosts have to authenticate, queues to fill.
pub const WARM_UP: Span = Span::from_millis(3000);
/// Time after the end of the window in which messages may still arrive.
pub const DRAIN: Span = Span::from_millis(2000);
/// Control period: 20 Hz, as in the paper.
pub const STEP: Span = Span::from_millis(50);

/// Age at a control step if no message was received yet.
pub const NEVER: Span = Span::from_millis(1_000_000);

/// Output of an endpoint.
#[derive(Clone, Debug)]
pub enum Output<P> {
    /// Sends a datagram.
    Send {
        /// Receiving station; none for all others.
        to: Option<u16>,
        /// Length of the datagram \[bytes\].
        bytes: usize,
        /// Content.
        packet: P,
    },
    /// Delivers a new message to the application.
    Deliver {
        /// Station that published it.
        from: u16,
        /// Its sequence number.
        sequence: u32,
    },
}

/// Endpoint of a protocol at one station.
pub trait Endpoint {
    /// Content of a datagram.
    type Packet: Clone;
    /// Publishes the message with this sequence number.
    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Output<Self::Packet>>);
    /// Handles a received datagram.
    fn receive(&mut self, now: Time, packet: &Self::Packet, out: &mut Vec<Output<Self::Packet>>);
    /// Returns when it next has to be woken.
    fn wake_at(&self) -> Option<Time>;
    /// Handles timers that have expired at `now`.
    fn wake(&mut self, now: Time, out: &mut Vec<Output<Self::Packet>>);
}
