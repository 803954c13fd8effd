//! Observations of policies that take more than fields of a robot's state: channels of the scenario and senses, as in a
//! run.

use std::collections::BTreeMap;
use std::sync::Arc;

use murmurate::config::ConfigError;
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::messages::local::Sensation;
use murmurate::messages::wire::Features;
use murmurate::observation::{Bound, Channel, ChannelError, Known, Observation, Request};
use murmurate::policy::hops::entry::Entry;
use murmurate::random::Stream;
use murmurate::scenario::{Arena, Scenario};
use murmurate::senses::{Scanner, Settings};
use murmurate::time::Span;

/// Observation of the robots of a role: its entries, and the channels among them, joined with those of scenarios.
#[derive(Clone, Debug)]
pub struct Perception {
    /// Entries of an observation.
    pub entries: Arc<[Entry]>,
    /// Channels among the entries; `None` if all are fields.
    pub channels: Option<Channels>,
}

/// Observation of the robots of a role, or of the critic, in training environments.
#[derive(Clone, Debug)]
pub(super) struct Observing {
    /// Entries of an observation, and the channels among them.
    pub perception: Perception,
    /// Memories of the channels of each robot's episode, one robot after the other.
    pub memory: Vec<f32>,
}

/// Channels and senses that a policy takes, joined with those of the scenarios of training environments.
#[derive(Clone, Debug)]
pub struct Channels {
    /// Channels of each team size, indexed by the team size.
    bound: Vec<Option<Bound>>,
    /// Lidars of a robot, in the order of their names.
    scanners: Vec<Scanner>,
    /// Newest values of each sense of the robot that is looked at.
    sensed: Vec<Option<Sensation>>,
    /// Values of the channels of that robot.
    values: Vec<f32>,
}

/// Robot that observes, among the robots of its team. All is in the world frame.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// Arena of the episode.
    pub arena: &'a Arena,
    /// Position of the robot's centre \[m\].
    pub centre: Vec2,
    /// Heading of the robot \[rad\].
    pub heading: f32,
    /// Positions of the centres of all robots of the team \[m\].
    pub team: &'a [Vec2],
    /// Index of the robot in the team.
    pub robot: usize,
}

impl Channels {
    /// Joins the channels among `entries` with those of `scenarios`, and with the `senses` of each robot, by their
    /// names; `None` if there is no channel among the entries. An error names the wrong setting of a sense, or the
    /// channel that a scenario has not.
    pub fn new(
        entries: &[Entry],
        senses: &BTreeMap<String, Settings>,
        scenarios: &[Arc<dyn Scenario>],
    ) -> Result<Option<Channels>, ConfigError> {
        let requests: Vec<Request> = entries.iter().filter_map(Entry::request).collect();
        let scanner = |(name, settings): (&String, &Settings)| {
            Scanner::of(name, settings).map_err(|error| error.within("senses"))
        };
        let scanners = senses.iter().map(scanner).collect::<Result<Vec<Scanner>, _>>()?;
        let of_senses: Vec<Channel> =
            senses.keys().zip(&scanners).enumerate().map(|(at, (name, scanner))| scanner.channel(name, at)).collect();
        let joined = Channels::joined(&requests, (scanners, &of_senses), scenarios);
        joined.map_err(|error| ConfigError::field("policy.observation", error.to_string()))
    }

    /// Joins the channels that a policy takes with those of `scenario`; `None` if it takes none.
    ///
    /// # Errors
    /// The scenario has not one of them, or has it otherwise.
    pub fn of_scenario(requests: &[Request], scenario: &Arc<dyn Scenario>) -> Result<Option<Channels>, ChannelError> {
        Channels::joined(requests, (Vec::new(), &[]), std::slice::from_ref(scenario))
    }

    fn joined(
        requests: &[Request],
        (scanners, of_senses): (Vec<Scanner>, &[Channel]),
        scenarios: &[Arc<dyn Scenario>],
    ) -> Result<Option<Channels>, ChannelError> {
        if requests.is_empty() {
            return Ok(None);
        }
        let largest = scenarios.iter().map(|scenario| scenario.robots()).max().unwrap_or(0);
        let mut bound = vec![None; largest + 1];
        for scenario in scenarios {
            let channels = [&scenario.channels(), of_senses].concat();
            bound[scenario.robots()] = Some(Bound::new(requests, &channels)?);
        }
        Ok(Some(Channels {
            sensed: vec![None; scanners.len()],
            values: vec![0.0; requests.iter().map(Request::floats).sum()],
            bound,
            scanners,
        }))
    }

    /// Returns the number of floats that the channels remember of a robot's episode.
    pub fn memory(&self) -> usize {
        self.bound.iter().flatten().map(Bound::memory).max().unwrap_or(0)
    }

    /// Makes the scans of a robot at this place. Noise and dropouts are drawn from `stream`; without it there are none.
    pub fn sense(&mut self, place: Place, mut stream: Option<&mut Stream>) {
        for (scanner, sensed) in self.scanners.iter_mut().zip(&mut self.sensed) {
            let others = place.team.iter().enumerate().filter(|(other, _)| *other != place.robot);
            let mut values = vec![0.0; scanner.rays()];
            let pose = (place.centre, place.heading, place.heading);
            scanner.scan(place.arena, pose, others.map(|(_, centre)| *centre), &mut values);
            if let Some(stream) = stream.as_deref_mut() {
                scanner.disturb(stream, &mut values);
            }
            *sensed = Some(Sensation { values: Features(values.into()), age: Span::ZERO });
        }
    }

    /// Returns the values of the channels of a robot whose scans `sense` has made, and changes their `memory` of it.
    /// `own` is its state, without values; `task` is its start and goal, and `team` those of all robots of its team,
    /// world frame.
    pub fn values(&mut self, memory: &mut [f32], own: &Observation, (task, team): (&Task, &[Option<Task>])) -> &[f32] {
        let bound = self.bound[team.len()].as_ref().expect("there are channels for every team size");
        bound.write(memory, &Known { task, team, own, sensed: &self.sensed }, &mut self.values);
        &self.values
    }
}
