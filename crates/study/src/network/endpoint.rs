//! Interface of a station's protocol in a network study, and the time constants of a case.

use murmurate::time::{Span, Time};

/// Duration of the warm-up of a network study's case: the time before its measurement, in which hosts authenticate and
/// queues fill.
pub const WARM_UP: Span = Span::from_millis(3000);
/// Duration of the drain of a network study's case: the time after its measurement, in which late messages may still
/// arrive.
pub const DRAIN: Span = Span::from_millis(2000);
/// Control period of robots: 20 Hz, as in the paper.
pub const STEP: Span = Span::from_millis(50);

/// Age that counts for a station from which no message was received yet: 1000 s, more than every limit.
pub const NEVER: Span = Span::from_millis(1_000_000);

/// Output of a station's protocol in a network study: a datagram to send, or a message for the application.
#[derive(Clone, Debug)]
pub enum Output<P> {
    /// Datagram to send.
    Send {
        /// Receiving station; `None` for all others.
        to: Option<u16>,
        /// Length of the datagram \[bytes\].
        bytes: usize,
        /// Content of the datagram.
        packet: P,
    },
    /// Datagram to send to all other stations by multicast, also in a case with unicast.
    Multicast {
        /// Length of the datagram \[bytes\].
        bytes: usize,
        /// Content of the datagram.
        packet: P,
    },
    /// New message of another station, delivered to the application.
    Deliver {
        /// Station that published the message.
        from: u16,
        /// Sequence number of the message.
        sequence: u32,
    },
}

/// Protocol at one station of a network study, such as the link layer or RTPS: turns publications, received datagrams
/// and timers into outputs.
pub trait StationProtocol {
    /// Content of a datagram.
    type Packet: Clone;
    /// Publishes the station's message with the number `sequence`: appends the datagrams to send to `out`.
    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Output<Self::Packet>>);
    /// Handles a received datagram: appends the messages that it delivers, and replies, to `out`.
    fn receive(&mut self, now: Time, packet: &Self::Packet, out: &mut Vec<Output<Self::Packet>>);
    /// Returns the time at which `wake` has to be called next; `None` if nothing is due.
    fn wake_at(&self) -> Option<Time>;
    /// Handles the protocol's timers that have expired at `now`, such as those of retransmissions: appends outputs
    /// to `out`.
    fn wake(&mut self, now: Time, out: &mut Vec<Output<Self::Packet>>);
}
