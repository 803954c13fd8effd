//! Localizer: publishes the readings of some robots from their source. It runs where they are measured.

use crate::actor::Core;
use crate::localization::{self, Source};
use crate::messages::local::Sample;
use crate::messages::wire::Reading;
use crate::time::Time;

/// Input of a Localizer.
#[derive(Clone, Debug)]
pub enum In {
    /// True state of a simulated robot.
    Sample(Sample),
    /// Packet from the source's worker.
    Packet(Box<[u8]>),
}

/// Localizer of one source.
pub struct Localizer {
    source: Box<dyn Source>,
    /// Number of packets that were not understood.
    refused: u64,
    outputs: Vec<localization::Out>,
}

impl Localizer {
    /// Makes a localizer without a measurement.
    pub fn new(source: Box<dyn Source>) -> Localizer {
        Localizer { source, refused: 0, outputs: Vec::new() }
    }

    fn forward(&mut self, out: &mut Vec<Reading>) {
        for output in self.outputs.drain(..) {
            match output {
                localization::Out::Reading(reading) => out.push(reading),
                localization::Out::Refused(why) => {
                    self.refused += 1;
                    // Log the counts 1, 2, 4, 8, ...: a broken tracker may send nothing else.
                    if self.refused.is_power_of_two() {
                        tracing::warn!(refused = self.refused, "output of the source is refused: {why}");
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
        self.source.take(now, input, &mut self.outputs);
        self.forward(out);
    }

    fn wake_at(&self) -> Option<Time> {
        self.source.wake_at()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Reading>) {
        self.source.wake(now, &mut self.outputs);
        self.forward(out);
    }
}
