//! Definition of an actor: a pure state machine with a typed mailbox, which `runtime` runs.

use crate::time::{Span, Time};

/// Logic of an actor: a pure state machine that takes messages and returns messages. It has no clock, no I/O and no
/// randomness of its own, so the runtime can run it in virtual or real time.
pub trait Core {
    /// Type of the messages that the actor receives.
    type In: 'static;
    /// Type of the messages that the actor sends.
    type Out;

    /// Handles one received message `input`. The runtime calls it for each message, with the present time `now`, and
    /// sends the messages that the actor appends to `out`.
    fn handle(&mut self, now: Time, input: Self::In, out: &mut Vec<Self::Out>);

    /// Returns the time at which the runtime has to call `wake` next; `None` if the actor only reacts to messages. An
    /// actor that needs a wake-up before its first message returns a past instant.
    fn wake_at(&self) -> Option<Time>;

    /// Returns the largest acceptable delay, in real time, of a wake-up that is due in `ahead`. A delay lets the
    /// runtime serve several wake-ups at once. The default zero is for control ticks; in virtual time no wake-up is
    /// delayed.
    fn tolerance(&self, ahead: Span) -> Span {
        let _ = ahead;
        Span::ZERO
    }

    /// Does the work that is due at time `now` and appends messages to send to `out`. The runtime calls it when the
    /// time that `wake_at` returned has come. Afterwards `wake_at` must be later than `now`.
    fn wake(&mut self, now: Time, out: &mut Vec<Self::Out>);
}
