//! Localizer: publishes readings of robots from one source, such as a tracker or a GNSS receiver. It runs on the host
//! of the source.
//!
//! What a real robot cannot have driven is no measurement, whatever its source: a screen (`localization::screen`)
//! judges each reading, and says which robots are lost.

use std::collections::BTreeMap;
use std::rc::Rc;

use crate::actor::Core;
use crate::chassis::Chassis;
use crate::localization::screen::Screen;
use crate::localization::{self, Source};
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::{Located, Place, Reading};
use crate::time::Time;

/// Input message of a Localizer, the actor that publishes the readings of one source.
#[derive(Clone, Debug)]
pub enum In {
    /// True state of a simulated robot, which the source turns into a reading.
    Sample(Sample),
    /// Packet from the worker of the source of readings, such as a tracker's datagram.
    Packet(Box<[u8]>),
    /// Pose and velocity from the own sensors of a robot whose Body runs on this host.
    Odometry(Reading),
    /// Statement of an operator of where a robot is.
    Place(Place),
}

/// Output message of a Localizer, the actor that publishes the readings of one source.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Measured pose and velocity of a robot.
    Reading(Reading),
    /// Robots whose poses are unknown, or an answer to an operator.
    Located(Located),
}

/// Localizer: an actor that publishes the readings (measured poses and velocities) of one source.
pub struct Localizer {
    source: Box<dyn Source>,
    /// Chassis of each robot, indexed by robot id.
    chassis: Rc<[Chassis]>,
    /// Number of inputs that the source refused, and of readings without the heading that their chassis needs, by robot
    /// and by reason. The robot is `None` if an input says of none.
    refused: BTreeMap<(Option<RobotId>, &'static str), u64>,
    outputs: Vec<localization::Out>,
    /// Judge of the readings of real robots; `None` for simulated ones, which a World may put anywhere.
    screen: Option<Screen>,
}

impl Localizer {
    /// Creates a Localizer that has received no measurement yet. The `source` measures the centres of robots. Published
    /// readings are of their commanded points, computed with `chassis`: the chassis of all robots, indexed by robot id.
    pub fn new(source: Box<dyn Source>, chassis: Rc<[Chassis]>) -> Localizer {
        Localizer { source, chassis, refused: BTreeMap::new(), outputs: Vec::new(), screen: None }
    }

    /// Returns the Localizer with a judge of the readings of its real robots.
    pub fn screened(mut self, screen: Screen) -> Localizer {
        screen.introduce(&mut *self.source);
        Localizer { screen: Some(screen), ..self }
    }

    fn forward(&mut self, now: Time, out: &mut Vec<Out>) {
        for output in self.outputs.drain(..) {
            let output = match &mut self.screen {
                Some(screen) => screen.judge(now, output, |robot| self.source.quality(robot)),
                None => output,
            };
            match output {
                localization::Out::Reading(reading) => match (reading.robot, self.chassis.get(reading.robot.index())) {
                    (_, None) => out.push(Out::Reading(reading)),
                    (robot, Some(chassis)) => match chassis.point(reading) {
                        Some(reading) => out.push(Out::Reading(reading)),
                        None => refuse(
                            &mut self.refused,
                            Some(robot),
                            "it has no heading, which a differential drive needs",
                        ),
                    },
                },
                localization::Out::Refused(why) => refuse(&mut self.refused, None, why),
                localization::Out::RefusedOf(robot, why) => refuse(&mut self.refused, Some(robot), why),
                localization::Out::Lost(robot, why) => refuse(&mut self.refused, Some(robot), why.reason()),
            }
        }
        out.extend(self.screen.as_mut().and_then(|screen| screen.report(now)).map(Out::Located));
    }
}

/// Adds 1 to the number of refusals of this robot for the reason `why`, and logs the reason at the counts 1, 2, 4, 8,
/// ...: a faulty tracker may send nothing else. So a rare reason is not hidden behind a frequent one.
fn refuse(refused: &mut BTreeMap<(Option<RobotId>, &'static str), u64>, robot: Option<RobotId>, why: &'static str) {
    let refused = refused.entry((robot, why)).or_default();
    *refused += 1;
    if refused.is_power_of_two() {
        match robot {
            Some(robot) => tracing::warn!(refused, "{robot}: a reading is refused: {why}"),
            None => tracing::warn!(refused, "output of the source is refused: {why}"),
        }
    }
}

impl Core for Localizer {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let input = match &input {
            In::Sample(sample) => localization::In::Sample(sample),
            In::Packet(packet) => localization::In::Packet(packet),
            In::Odometry(reading) => {
                self.screen.iter_mut().for_each(|screen| screen.odometry(now, reading));
                localization::In::Odometry(reading)
            }
            In::Place(place) => {
                let answer = self.screen.as_mut().and_then(|screen| screen.place(now, place, &mut *self.source));
                return out.extend(answer.map(Out::Located));
            }
        };
        self.source.take(now, input, &mut self.outputs);
        self.forward(now, out);
    }

    fn wake_at(&self) -> Option<Time> {
        let repeats = self.screen.as_ref().and_then(Screen::wake_at);
        [self.source.wake_at(), repeats].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.source.wake_at().is_some_and(|at| at <= now) {
            self.source.wake(now, &mut self.outputs);
        }
        self.forward(now, out);
    }
}
