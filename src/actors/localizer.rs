//! Localizer: publishes the readings of some robots, as their source has them. It lives where they are measured.

use crate::actor::Core;
use crate::localization::{self, Source};
use crate::messages::local::Sample;
use crate::messages::wire::Reading;
use crate::time::Time;

/// What a Localizer accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// The true state of a simulated robot.
    Sample(Sample),
    /// Something that the source's worker has said.
    Packet(Box<[u8]>),
}

/// The localizer of one source.
pub struct Localizer {
    source: Box<dyn Source>,
    /// What could not be understood so far.
    refused: u64,
    said: Vec<localization::Out>,
}

impl Localizer {
    /// A localizer that has not measured yet.
    pub fn new(source: Box<dyn Source>) -> Localizer {
        Localizer { source, refused: 0, said: Vec::new() }
    }

    fn tell(&mut self, out: &mut Vec<Reading>) {
        for said in self.said.drain(..) {
            match said {
                localization::Out::Reading(reading) => out.push(reading),
                localization::Out::Refused(why) => {
                    self.refused += 1;
                    // The first, and then less and less often: a broken tracker says nothing else.
                    if self.refused.is_power_of_two() {
                        tracing::warn!(refused = self.refused, "what the source says is refused: {why}");
                    }
                }
            }
        }
    }
}

impl Core for Localizer {
    type In = In;
    type Out = Reading;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Reading>) {
        let input = match &input {
            In::Sample(sample) => localization::In::Sample(sample),
            In::Packet(packet) => localization::In::Packet(packet),
        };
        self.source.take(now, input, &mut self.said);
        self.tell(out);
    }

    fn wake_at(&self) -> Option<Time> {
        self.source.wake_at()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Reading>) {
        self.source.wake(now, &mut self.said);
        self.tell(out);
    }
}
