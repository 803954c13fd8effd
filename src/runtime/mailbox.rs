//! Mailbox of an actor: a bounded queue, by which others send it messages, and counts of those that were dropped.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use super::clock::{Clock, TaskId};
use crate::faults::ActorFault;
use crate::time::Time;

/// Largest number of messages in a mailbox: all messages of a team of 2000 robots in one control period, eight for each
/// robot.
pub const MAILBOX_CAPACITY: usize = 16_384;

/// Content of a mailbox.
pub(super) enum Envelope<I> {
    /// Message that the actor handles in its next turn.
    Deliver(I),
    /// Message that the actor handles as of the time at which it was left.
    Left(Time, I),
    /// Fault that is injected into the actor.
    Inject(ActorFault),
    /// End of all injected faults.
    Recover,
}

/// Queue of the messages for one actor, and the address by which others send them, on one thread. Clones are cheap and
/// share the queue. A mailbox is made before its actor, so actors can hold each other's mailboxes.
pub struct Mailbox<I>(pub(super) Rc<Slot<I>>);

/// Content that the clones of a mailbox share.
pub(super) struct Slot<I> {
    name: String,
    pub(super) queue: RefCell<VecDeque<Envelope<I>>>,
    /// Clock and task by which a message wakes the actor; empty until the actor is started.
    pub(super) waker: OnceCell<(Clock, TaskId)>,
    /// Whether the queue has messages that were left for the actor, which is not woken for them.
    pub(super) left: Cell<bool>,
    /// Makes the actor before this one handle what was left for it; empty if no actor is before this one.
    pub(super) before: OnceCell<Box<dyn Fn()>>,
    refused: Cell<u64>,
    lost: Cell<u64>,
}

impl<I> Clone for Mailbox<I> {
    fn clone(&self) -> Self {
        Mailbox(Rc::clone(&self.0))
    }
}

impl<I> Mailbox<I> {
    /// Makes a mailbox for an actor called `name`, which [`start`](super::shell::start) starts later.
    pub fn new(name: impl Into<String>) -> Mailbox<I> {
        Mailbox(Rc::new(Slot {
            name: name.into(),
            queue: RefCell::default(),
            waker: OnceCell::new(),
            left: Cell::new(false),
            before: OnceCell::new(),
            refused: Cell::new(0),
            lost: Cell::new(0),
        }))
    }

    /// Returns the name of the actor whose mailbox this is.
    pub(crate) fn name(&self) -> &str {
        &self.0.name
    }

    /// Puts a message into the mailbox and wakes its actor; a full mailbox drops and counts the message.
    pub fn send(&self, input: I) {
        self.post(Envelope::Deliver(input));
    }

    /// Leaves a message in the mailbox without waking its actor, which handles it when it next runs, as of now. It is
    /// for messages upon which an actor does nothing but remember, in a run in virtual time: what it puts out for them
    /// is left in the mailboxes of others.
    pub fn leave(&self, input: I) {
        let (clock, _) = self.0.waker.get().expect("its actor was started");
        clock.as_of(clock.now(), || self.send(input));
    }

    /// Makes the actor of `earlier` handle what was left for it, each time before the actor of this mailbox runs or
    /// gets a fault.
    pub fn runs_after<J: 'static>(&self, earlier: &Mailbox<J>) {
        let earlier = Rc::downgrade(&earlier.0);
        let settle = move || earlier.upgrade().iter().for_each(|slot| slot.settle());
        assert!(self.0.before.set(Box::new(settle)).is_ok(), "{} runs after one other actor", self.name());
    }

    /// Injects a fault, such as a crash or a delay, into the actor of this mailbox.
    pub fn inject(&self, fault: ActorFault) {
        self.0.before.get().iter().for_each(|settle| settle());
        self.post(Envelope::Inject(fault));
    }

    /// Ends all injected faults of the actor of this mailbox; a crashed actor restarts.
    pub(crate) fn recover(&self) {
        self.post(Envelope::Recover);
    }

    /// Returns the number of messages that were dropped because this mailbox was full.
    pub fn refused(&self) -> u64 {
        self.0.refused.get()
    }

    /// Returns the number of messages that were lost in crashes of the actor.
    pub fn lost(&self) -> u64 {
        self.0.lost.get()
    }

    fn post(&self, envelope: Envelope<I>) {
        let slot = &*self.0;
        let mut queue = slot.queue.borrow_mut();
        if queue.len() >= MAILBOX_CAPACITY {
            return self.refuse();
        }
        match (slot.waker.get(), envelope) {
            (Some((clock, _)), Envelope::Deliver(input)) if clock.is_past() => {
                queue.push_back(Envelope::Left(clock.now(), input));
                slot.left.set(true);
            }
            (waker, envelope) => {
                queue.push_back(envelope);
                if let Some((clock, actor)) = waker {
                    clock.wake(*actor);
                }
            }
        }
    }

    /// Counts a message that is dropped because the mailbox is full.
    pub(super) fn refuse(&self) {
        self.0.refused.set(self.0.refused.get() + 1);
    }

    /// Counts messages that are lost in a crash of the actor.
    pub(super) fn lose(&self, messages: usize) {
        self.0.lost.set(self.0.lost.get() + messages as u64);
    }
}

impl<I> Slot<I> {
    /// Makes the actor handle what was left for it.
    fn settle(&self) {
        if let (true, Some((clock, actor))) = (self.left.get(), self.waker.get()) {
            clock.run(*actor);
        }
    }
}
