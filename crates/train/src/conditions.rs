//! Conditions of one episode, drawn at its start from the configured ranges.

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::config::{Conditions, Range};
use murmurate::observation::Dynamics;
use murmurate::random::Stream;
use murmurate::safety::Clamp;
use murmurate::scenario::Arena;
use murmurate::scenario::size::HULL_M;
use murmurate::world::kinematic::{MAX_ACCELERATION_M_S2, PERIOD};
use murmurate::world::{ContactRule, Physics};

/// Conditions of one training episode of one team: messages, sensor noise and physics.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeConditions {
    /// Whether all robots act at the same time, on messages without delay or loss.
    pub lockstep: bool,
    /// Time constant \[s\] of the lag of the robots' drives, for deployed physics. `None` selects the physics of the
    /// paper's environment, without lag.
    pub lag_s: Option<f32>,
    /// Distance between a robot's centre and a wall below which the robot touches the wall \[m\], in deployed physics.
    pub wall_radius_m: f32,
    /// Age, counted from its arrival, up to which a message is used \[s\].
    pub hold_s: f32,
    /// Standard deviation of the communication range \[m\], which is drawn anew for each message.
    pub range_std_m: f32,
    /// Standard deviation of the noise on each axis of a measured position \[m\].
    pub position_noise_m: f32,
    /// Standard deviation of the noise on each axis of a measured velocity \[m/s\].
    pub velocity_noise_m_s: f32,
    /// Time from the start of each step of 50 ms to the robot's action in it \[s\], one entry per robot.
    pub phase_s: Vec<f32>,
    /// Delay \[s\] and loss probability of messages from one robot to another: by receiver, then by sender. No message
    /// uses the entries from a robot to itself.
    pub edges: Vec<(f32, f32)>,
    /// Range of communication: the policy's radius, or unlimited.
    #[serde(default)]
    pub connectivity: Connectivity,
    /// Limit that is applied to the policy's velocities. In deployed physics it says what limits acceleration: the
    /// simulated wheels (`Clamp::Training`) or the robot's controller (`Clamp::Deployed`).
    #[serde(default)]
    pub clamp: Clamp,
    /// Whether the safety filter limits the policy's velocities.
    #[serde(default)]
    pub filtered: bool,
}

/// Range of communication in an episode. Checkpoints contain the names of the variants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Connectivity {
    /// Robots within the policy's communication radius receive each other's messages.
    #[default]
    Radius,
    /// All robots receive each other's messages, at any distance.
    Everyone,
}

fn draw([low, high]: Range, stream: &mut Stream) -> f32 {
    if high > low { stream.random_range(low..high) } else { low }
}

impl EpisodeConditions {
    /// Returns the conditions of the paper's own training for a team of `robots` robots: all act at the same time, and
    /// messages have neither delay nor loss.
    pub fn perfect(robots: usize) -> EpisodeConditions {
        EpisodeConditions {
            lockstep: true,
            hold_s: PERIOD.as_secs() as f32,
            phase_s: vec![0.0; robots],
            edges: vec![(0.0, 0.0); robots * robots],
            ..EpisodeConditions::default()
        }
    }

    /// Draws the conditions of one episode of a team of `robots` robots from the distributions `conditions`, with the
    /// random numbers of `stream`.
    pub fn draw(conditions: &Conditions, robots: usize, stream: &mut Stream) -> EpisodeConditions {
        let mut episode = EpisodeConditions::perfect(robots);
        // Nothing is drawn for a probability of zero. So a configuration that lacks a newer field, whose default is
        // zero, gets the same random numbers as before.
        let happens = |probability: f32, stream: &mut Stream| probability > 0.0 && stream.random::<f32>() < probability;
        episode.lockstep = stream.random::<f32>() < conditions.clean;
        let always = conditions.filtered_from.is_some_and(|least| robots >= least);
        if stream.random::<f32>() < conditions.deployed || always {
            episode.lag_s = Some(draw(conditions.lag_s, stream));
            let wheels = happens(conditions.wheels, stream);
            episode.clamp = if wheels { Clamp::Training } else { Clamp::Deployed };
            episode.filtered = happens(conditions.filtered, stream) || always;
            let room = conditions.filtered_wall_radius_m.filter(|_| episode.filtered);
            episode.wall_radius_m = room.map_or(conditions.wall_radius_m, |range| draw(range, stream));
        } else {
            episode.filtered = happens(conditions.filtered_published, stream);
        }
        if happens(conditions.everyone, stream) {
            episode.connectivity = Connectivity::Everyone;
        }
        if episode.lockstep {
            return episode;
        }
        episode.hold_s = draw(conditions.hold_s, stream);
        episode.range_std_m = draw(conditions.range_std_m, stream);
        episode.position_noise_m = draw(conditions.position_noise_m, stream);
        episode.velocity_noise_m_s = draw(conditions.velocity_noise_m_s, stream);
        let (delay_s, loss) = (draw(conditions.delay_s, stream), draw(conditions.loss, stream));
        for edge in &mut episode.edges {
            let mut factor = || 1.0 + conditions.edge_spread * stream.random_range(-1.0f32..1.0);
            *edge = ((delay_s * factor()).min(0.5), (loss * factor()).min(1.0));
        }
        for phase in &mut episode.phase_s {
            *phase = stream.random_range(0.0..PERIOD.as_secs() as f32);
        }
        episode
    }

    /// Returns whether conditions that were read are those of a team of `robots` robots, within the bounds that
    /// configurations have.
    pub(super) fn is_sound(&self, robots: usize) -> bool {
        let within = |value: f32, most: f32| (0.0..=most).contains(&value);
        let period_s = PERIOD.as_secs() as f32;
        self.phase_s.len() == robots
            && self.edges.len() == robots * robots
            && self.phase_s.iter().all(|phase_s| within(*phase_s, period_s))
            && self.edges.iter().all(|(delay_s, loss)| within(*delay_s, 0.5) && within(*loss, 1.0))
            && within(self.hold_s, 0.5)
            && within(self.wall_radius_m, 10.0)
            && within(self.range_std_m, 100.0)
            && within(self.position_noise_m, 10.0)
            && within(self.velocity_noise_m_s, 10.0)
            && self.lag_s.is_none_or(|lag_s| within(lag_s, 10.0))
    }

    /// Returns the physical parameters of the robots in this episode; `arena` gives their radius and their hull, with
    /// which the distance of contact grows or shrinks.
    pub fn physics(&self, arena: &Arena) -> Physics {
        match self.lag_s {
            None => Physics::published(arena),
            Some(lag_s) => Physics {
                contacts: ContactRule::Judge,
                wall_radius_m: self.wall_radius_m * (arena.hull_m() / HULL_M),
                acceleration_m_s2: match self.clamp {
                    Clamp::Training => MAX_ACCELERATION_M_S2,
                    Clamp::Deployed => f32::INFINITY,
                },
                lag_s,
                ..Physics::published(arena)
            },
        }
    }

    /// Returns how the robots follow their policy's commands in this episode.
    pub fn dynamics(&self) -> Dynamics {
        Dynamics { filtered: self.filtered, lag_s: self.lag_s.unwrap_or(0.0), ..Dynamics::default() }
    }

    /// Returns the mean delay \[s\] and the mean loss probability over all entries of `edges`.
    pub fn mean_edge(&self) -> (f32, f32) {
        let count = self.edges.len().max(1) as f32;
        let sum = self.edges.iter().fold((0.0, 0.0), |sum, edge| (sum.0 + edge.0, sum.1 + edge.1));
        (sum.0 / count, sum.1 / count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use murmurate::random::Seed;

    #[test]
    fn large_teams_always_have_the_filter_and_small_ones_their_share() {
        let config = Config::preset("any-size").expect("it is a preset");
        let conditions = Conditions { filtered: 0.25, deployed: 0.5, filtered_from: Some(6), ..config.conditions };
        let mut stream = Seed::of_run(3).stream("conditions");
        let mut filtered = |robots: usize| {
            let episodes = (0..400).map(|_| EpisodeConditions::draw(&conditions, robots, &mut stream));
            episodes.filter(|episode| episode.filtered && episode.lag_s.is_some()).count()
        };
        assert_eq!([6, 12].map(&mut filtered), [400, 400]);
        // An eighth of 400, within three standard deviations.
        assert!((30..=70).contains(&filtered(5)), "{}", filtered(5));
    }

    #[test]
    fn episodes_with_published_physics_have_the_filter_for_a_share_of_their_own() {
        let config = Config::preset("any-size").expect("it is a preset");
        let conditions = Conditions { deployed: 0.5, filtered: 0.0, filtered_published: 0.5, ..config.conditions };
        let mut stream = Seed::of_run(5).stream("conditions");
        let episodes: Vec<EpisodeConditions> =
            (0..400).map(|_| EpisodeConditions::draw(&conditions, 5, &mut stream)).collect();
        let filtered = episodes.iter().filter(|episode| episode.filtered).count();
        assert!((75..=125).contains(&filtered), "a quarter of 400, within three standard deviations: {filtered}");
        assert!(episodes.iter().all(|episode| !episode.filtered || episode.lag_s.is_none()));
    }

    #[test]
    fn walls_are_at_a_random_distance_in_filtered_episodes_alone() {
        let config = Config::preset("any-size").expect("it is a preset");
        let filtered_wall_radius_m = Some([0.1, 0.3]);
        let conditions = Conditions { deployed: 1.0, filtered: 0.5, filtered_wall_radius_m, ..config.conditions };
        let mut stream = Seed::of_run(4).stream("conditions");
        let episodes: Vec<EpisodeConditions> =
            (0..400).map(|_| EpisodeConditions::draw(&conditions, 5, &mut stream)).collect();
        let radii = |filtered: bool| episodes.iter().filter(move |e| e.filtered == filtered).map(|e| e.wall_radius_m);
        assert!(radii(false).all(|radius_m| radius_m == conditions.wall_radius_m) && radii(false).count() > 150);
        assert!(radii(true).all(|radius_m| (0.1..0.3).contains(&radius_m)));
        assert!(radii(true).any(|radius_m| radius_m < 0.15) && radii(true).any(|radius_m| radius_m > 0.25));
    }
}
