//! Senses: publishes what one robot perceives of its surroundings. It runs on the host of the robot's Body.

use std::collections::BTreeMap;

use crate::actor::Core;
use crate::messages::ids::RobotId;
use crate::messages::local::Scene;
use crate::messages::wire::Sensed;
use crate::scenario::layout::Layouts;
use crate::senses::{self, Sense};
use crate::time::Time;

/// Input message of a Senses, the actor that publishes the values of one robot's senses.
#[derive(Clone, Debug)]
pub enum In {
    /// True poses of all robots, from the World that simulates the robot.
    Scene(Scene),
    /// Packet from the worker of the sense with this index.
    Packet(u8, Box<[u8]>),
}

/// Sense of the robot with its index, its name and the number of its values.
pub struct Named {
    /// Index of the sense among those of the team.
    pub index: u8,
    /// Name of the sense in the deployment.
    pub name: String,
    /// Number of values.
    pub floats: usize,
    /// The sense.
    pub sense: Box<dyn Sense>,
}

/// Senses: an actor that publishes the values of all senses of one robot.
pub struct Senses {
    robot: RobotId,
    senses: Vec<Named>,
    /// Number of inputs or values that were refused, by the place of the sense and by reason.
    refused: BTreeMap<(usize, &'static str), u64>,
    outputs: Vec<senses::Out>,
    /// Arenas of the episodes, where these differ, and the episode whose arena the senses have.
    layouts: Layouts,
    entered: Option<u32>,
}

impl Senses {
    /// Creates the actor of a robot with these senses, in the order of their names.
    pub fn new(robot: RobotId, senses: Vec<Named>) -> Senses {
        let (refused, outputs) = (BTreeMap::new(), Vec::new());
        Senses { robot, senses, refused, outputs, layouts: Layouts::default(), entered: None }
    }

    /// Returns the actor with the layouts of the trial: its senses perceive the obstacles of each episode.
    pub fn with_layouts(self, layouts: Layouts) -> Senses {
        Senses { layouts, ..self }
    }

    /// Gives the senses the arena of an episode, if it is another one than before.
    fn enter(&mut self, episode: u32) {
        let Some(arena) = self.layouts.arena(episode).filter(|_| self.entered != Some(episode)) else { return };
        self.senses.iter_mut().for_each(|named| named.sense.enter(arena));
        self.entered = Some(episode);
    }

    /// Publishes what the sense at this place has put out.
    fn forward(&mut self, index: usize, out: &mut Vec<Sensed>) {
        for output in std::mem::take(&mut self.outputs) {
            let refused = match output {
                senses::Out::Refused(why) => why,
                senses::Out::Values { values, .. } if values.len() != self.senses[index].floats => {
                    "its values are not as many as it has said"
                }
                senses::Out::Values { stamp_ns, values } => {
                    match Sensed::split(self.robot, self.senses[index].index, stamp_ns, &values) {
                        Some(all) => {
                            out.extend(all);
                            continue;
                        }
                        None => "a value is not finite or beyond a million",
                    }
                }
            };
            self.refuse(index, refused);
        }
    }

    /// Adds 1 to the number of refusals of a sense for the reason `why`, and logs it at the counts 1, 2, 4, 8, ...
    fn refuse(&mut self, index: usize, why: &'static str) {
        let refused = self.refused.entry((index, why)).or_default();
        *refused += 1;
        if refused.is_power_of_two() {
            let (robot, name) = (self.robot, &self.senses[index].name);
            tracing::warn!(refused, "{robot}: an output of its sense '{name}' is refused: {why}");
        }
    }
}

impl Core for Senses {
    type In = In;
    type Out = Sensed;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Sensed>) {
        match input {
            In::Scene(scene) => {
                self.enter(scene.episode);
                for index in 0..self.senses.len() {
                    self.senses[index].sense.take(now, senses::In::Scene(&scene), &mut self.outputs);
                    self.forward(index, out);
                }
            }
            In::Packet(index, packet) => {
                if let Some(at) = self.senses.iter().position(|named| named.index == index) {
                    self.senses[at].sense.take(now, senses::In::Packet(&packet), &mut self.outputs);
                    self.forward(at, out);
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.senses.iter().filter_map(|named| named.sense.wake_at()).min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Sensed>) {
        for index in 0..self.senses.len() {
            if self.senses[index].sense.wake_at().is_some_and(|due| due <= now) {
                self.senses[index].sense.wake(now, &mut self.outputs);
                self.forward(index, out);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sense that puts out its packet, each byte as a value; 255 as what is not a number.
    struct Bytes;

    impl Sense for Bytes {
        fn take(&mut self, now: Time, input: senses::In, out: &mut Vec<senses::Out>) {
            let senses::In::Packet(packet) = input else { return };
            let value = |byte: &u8| if *byte == 255 { f32::NAN } else { f32::from(*byte) };
            let values = packet.iter().map(value).collect();
            out.push(senses::Out::Values { stamp_ns: now.as_nanos(), values });
        }
    }

    #[test]
    fn values_are_published_with_the_index_of_their_sense_and_bad_ones_are_counted() {
        let named = |index: u8, name: &str| Named { index, name: name.to_owned(), floats: 2, sense: Box::new(Bytes) };
        let mut senses = Senses::new(RobotId(3), vec![named(0, "a"), named(2, "c")]);
        let mut out = Vec::new();
        for (index, packet) in [(2, vec![4, 5]), (0, vec![1]), (2, vec![1, 255]), (1, vec![1, 2])] {
            senses.handle(Time::from_nanos(7), In::Packet(index, packet.into()), &mut out);
        }
        let [sensed] = &out[..] else { panic!("one is valid: {out:?}") };
        assert_eq!((sensed.robot, sensed.sense, sensed.stamp_ns), (RobotId(3), 2, 7));
        assert_eq!(*sensed.values.0, [4.0, 5.0]);
        assert_eq!(senses.refused.values().sum::<u64>(), 2);
    }
}
