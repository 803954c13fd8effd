//! Agent whose steps take time under virtual time, as those of a policy on a worker's thread do in real time.
//!
//! It is the part on the control thread with a worker beside it that answers each step this long after it was asked. So
//! a step is late, is taken back and is repeated by the same rules as on a real host.

use super::apart::{self, Apart, answer};
use super::{Agent, In, Out};
use crate::actor::Core;
use crate::edge::Packet;
use crate::time::{Span, Time};

/// Agent under virtual time with the time that each of its steps takes.
pub struct Timed {
    apart: Apart,
    agent: Agent,
    /// Time from the question to the answer.
    takes: Span,
    /// Answers on their way, each with the time at which it is there.
    answers: Vec<(Time, Packet)>,
    outputs: Vec<apart::Out>,
}

impl Timed {
    /// Creates an Agent whose steps take the time `takes`: `agent`, and its part on the control thread.
    pub fn new(apart: Apart, agent: Agent, takes: Span) -> Timed {
        Timed { apart, agent, takes, answers: Vec::new(), outputs: Vec::new() }
    }

    /// Passes on what the part on the control thread has put out, and has its question answered.
    fn forward(&mut self, now: Time, out: &mut Vec<Out>) {
        for output in std::mem::take(&mut self.outputs) {
            match output {
                apart::Out::Agent(output) => out.push(output),
                apart::Out::Ask(request) => self.answers.push((now + self.takes, answer(&mut self.agent, &request))),
            }
        }
    }
}

impl Core for Timed {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        self.apart.handle(now, input, &mut self.outputs);
        self.forward(now, out);
    }

    fn wake_at(&self) -> Option<Time> {
        let answered = self.answers.iter().map(|(due, _)| *due);
        answered.chain(self.apart.wake_at()).min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        // An answer at its deadline is in time.
        while let Some(at) = self.answers.iter().position(|(due, _)| *due <= now) {
            let (_, packet) = self.answers.remove(at);
            self.apart.handle(now, In::Answer(packet), &mut self.outputs);
            self.forward(now, out);
        }
        if self.apart.wake_at().is_some_and(|due| due <= now) {
            self.apart.wake(now, &mut self.outputs);
            self.forward(now, out);
        }
    }
}
