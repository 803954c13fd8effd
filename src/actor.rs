//! What an actor is: a pure state machine with a typed mailbox, which `runtime` runs.

use crate::time::{Span, Time};

/// A state machine with a typed mailbox. No clock, no I/O, no randomness of its own.
pub trait Core {
    /// Everything that this mailbox accepts.
    type In: 'static;
    /// Everything that this actor may say.
    type Out;

    /// Takes one message.
    fn handle(&mut self, now: Time, input: Self::In, out: &mut Vec<Self::Out>);

    /// When `wake` is next due; `None` if only messages matter. A core that wants to be woken before its
    /// first message answers with a past instant.
    fn wake_at(&self) -> Option<Time>;

    /// How late a wake-up that is due in `ahead` may come, in real time, to share one with something else; a control
    /// tick takes none. Virtual time is always on time.
    fn tolerance(&self, ahead: Span) -> Span {
        let _ = ahead;
        Span::ZERO
    }

    /// Does what was due at `now`. Afterwards `wake_at` is later than `now`.
    fn wake(&mut self, now: Time, out: &mut Vec<Self::Out>);
}
