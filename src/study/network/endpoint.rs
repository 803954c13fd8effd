//! The end of a protocol at one station, and the times of a case, emulated or measured.

use crate::time::{Span, Time};

/// Stations speak for so long before anything is counted: hosts have to prove themselves, queues to fill.
pub const WARM: Span = Span::from_millis(3000);
/// What is under way at the end of the window has so long to arrive.
pub const DRAIN: Span = Span::from_millis(2000);
/// The paper's control steps: 20 Hz.
pub const STEP: Span = Span::from_millis(50);

/// The age of what never came, at a control step.
pub const NEVER: Span = Span::from_millis(1_000_000);

/// What a station does.
#[derive(Clone, Debug)]
pub enum Said<P> {
    /// It gives its medium something to send: for one, or for all the others.
    Send {
        /// For whom.
        to: Option<u16>,
        /// Length of the datagram.
        bytes: usize,
        /// What it is.
        packet: P,
    },
    /// It has a message that it had not before.
    Hear {
        /// Of whom.
        from: u16,
        /// Which one.
        sequence: u32,
    },
}

/// The end of a protocol at one station.
pub trait Endpoint {
    /// What is on its way between two ends.
    type Packet: Clone;
    /// The station says its message of this number.
    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Said<Self::Packet>>);
    /// Something has arrived.
    fn receive(&mut self, now: Time, packet: &Self::Packet, out: &mut Vec<Said<Self::Packet>>);
    /// When anything is next due.
    fn wake_at(&self) -> Option<Time>;
    /// Does what is due.
    fn wake(&mut self, now: Time, out: &mut Vec<Said<Self::Packet>>);
}
