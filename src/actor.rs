//! Definition of an actor: a pure state machine with a typed mailbox, which `runtime` runs.

use crate::time::{Span, Time};

/// Pure state machine with a typed mailbox: no clock, no I/O, no randomness of its own.
pub trait Core {
    /// Messages that this mailbox accepts.
    type In: 'static;
    /// Messages that this actor sends.
    type Out;

    /// Handles one message.
    fn handle(&mut self, now: Time, input: Self::In, out: &mut Vec<Self::Out>);

    /// Time at which `wake` is next due; `None` if only messages matter. A core that needs a wake-up before its first
    /// message returns a past instant.
    fn wake_at(&self) -> Option<Time>;

    /// Largest delay of a wake-up due in `ahead`, in real time, to share it with another one. It is zero for control
    /// ticks. Virtual time has no delay.
    fn tolerance(&self, ahead: Span) -> Span {
        let _ = ahead;
        Span::ZERO
    }

    /// Does what is due at `now`. Afterwards `wake_at` is later than `now`.
    fn wake(&mut self, now: Time, out: &mut Vec<Self::Out>);
}
