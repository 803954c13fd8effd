//! Ages of messages at decisions: from the publication of a message to the control step that uses it.
//!
//! The same rules count for a record and for a simulation. A robot decides when it publishes a latent. It uses the
//! newest message of every other robot that arrived within the hold time and, on arrival, was within range of where the
//! robot had last reported itself to be. Only messages that crossed hosts in a running episode count.

use std::collections::BTreeMap;

use murmurate::hearing::Handling;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::phase::Phase;
use murmurate::messages::wire::Latent;
use murmurate_record::clocks::DatagramKey;

/// Rules by which robots use neighbours' messages: communication range, hold time and handling.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Largest distance \[m\] at which a robot uses a neighbour's message.
    pub range_m: f32,
    /// Longest time for which a message is used after its arrival \[ns\].
    pub hold_ns: i64,
    /// Use of a message: for the whole hold time, or in one control step only.
    pub handling: Handling,
}

/// Decisions of all robots in one episode: their number, and the ages of the neighbours' messages that they used.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decisions {
    /// Number of decisions (control steps) of all robots in the episode.
    pub count: usize,
    /// Ages \[s\] of the messages that these decisions used, from publication to decision.
    pub ages_s: Vec<f64>,
}

/// Latent that a robot has published: the robot, the time, and its reported position.
#[derive(Clone, Copy)]
struct Published {
    robot: RobotId,
    at_ns: i64,
    position: Vec2,
}

/// Message that a robot holds of another one: times of arrival and of publication \[ns\].
#[derive(Clone, Copy)]
struct Held {
    arrived_ns: i64,
    published_ns: i64,
}

/// Follows latents from publication to the decisions that use them, and collects their ages. The caller reports
/// publications and arrivals in the order of their times on one clock.
pub struct Follower {
    rules: Rules,
    /// By robot: the host of its agent.
    hosts: Vec<HostId>,
    published: BTreeMap<DatagramKey, Published>,
    /// By robot: position that it last reported \[m\], world frame; `None` before the first report.
    places: Vec<Option<Vec2>>,
    /// By receiving and sending robot: newest message that the receiver holds of the sender.
    held: BTreeMap<(RobotId, RobotId), Held>,
    decisions: BTreeMap<u32, Decisions>,
}

impl Follower {
    /// Returns a follower of a team's latents. `hosts` has the host of each robot's agent, in the order of the robots.
    pub fn new(rules: Rules, hosts: Vec<HostId>) -> Follower {
        Follower {
            rules,
            places: vec![None; hosts.len()],
            hosts,
            published: BTreeMap::new(),
            held: BTreeMap::new(),
            decisions: BTreeMap::new(),
        }
    }

    /// Handles a latent that a robot publishes at `at_ns` \[ns\] in the datagram `key`. In a running episode this is a
    /// decision of that robot, and the ages of the messages that it uses are stored.
    pub fn publish(&mut self, at_ns: i64, key: DatagramKey, latent: &Latent) {
        let robot = latent.robot;
        let Some(place) = self.places.get_mut(robot.index()) else { return };
        *place = Some(latent.motion.position);
        if latent.phase == Phase::Running {
            self.decide(at_ns, robot, latent.round.episode);
        }
        self.published.insert(key, Published { robot, at_ns, position: latent.motion.position });
    }

    fn decide(&mut self, now_ns: i64, robot: RobotId, episode: u32) {
        let decisions = self.decisions.entry(episode).or_default();
        decisions.count += 1;
        let of_robot = (robot, RobotId(0))..=(robot, RobotId(u16::MAX));
        for (_, held) in self.held.range(of_robot.clone()) {
            if now_ns - held.arrived_ns <= self.rules.hold_ns {
                decisions.ages_s.push((now_ns - held.published_ns) as f64 / 1e9);
            }
        }
        if self.rules.handling == Handling::AsPublished {
            self.held.retain(|pair, _| !of_robot.contains(pair));
        }
    }

    /// Handles the datagram `key`, which arrives at the host `to` at `at_ns` \[ns\]. It counts only if it contains a
    /// latent whose publication was reported before.
    pub fn arrive(&mut self, at_ns: i64, to: HostId, key: &DatagramKey) {
        let Some(&Published { robot: sender, at_ns: published_ns, position }) = self.published.get(key) else { return };
        if self.hosts[sender.index()] == to {
            return;
        }
        for robot in RobotId::team(self.hosts.len()).filter(|robot| self.hosts[robot.index()] == to) {
            let Some(place) = self.places[robot.index()] else { continue };
            let near = (place - position).norm() <= self.rules.range_m;
            let newer = self.held.get(&(robot, sender)).is_none_or(|held| held.published_ns < published_ns);
            if near && newer {
                self.held.insert((robot, sender), Held { arrived_ns: at_ns, published_ns });
            }
        }
    }

    /// Returns the decisions of each episode, with the ages of the messages that they used, by the number of the
    /// episode.
    pub fn into_decisions(self) -> BTreeMap<u32, Decisions> {
        self.decisions
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::messages::geometry::Motion;
    use murmurate::messages::wire::{Features, Round};

    #[test]
    fn a_decision_uses_the_newest_message_of_each_robot_in_range_until_it_is_too_old() {
        let rules = Rules { range_m: 2.0, hold_ns: 200_000_000, handling: Handling::Hold };
        let mut follower = Follower::new(rules, vec![HostId(0), HostId(1), HostId(2)]);
        let ms = |ms: i64| ms * 1_000_000;
        let mut number = 0;
        let mut publish = |follower: &mut Follower, at: i64, robot: u16, x: f32| {
            number += 1;
            let motion = Motion::at_rest(Vec2::new(x, 0.0));
            let features = Features(std::sync::Arc::new([]));
            let round = Round { term: 1, episode: 4 };
            let latent = Latent { robot: RobotId(robot), round, phase: Phase::Running, motion, features, part: None };
            let key = (robot, 1, number, 0);
            follower.publish(ms(at), key, &latent);
            key
        };
        publish(&mut follower, 0, 0, 0.0);
        let near = publish(&mut follower, 10, 1, 1.9);
        let far = publish(&mut follower, 10, 2, 2.1);
        for key in [&near, &far] {
            follower.arrive(ms(30), HostId(0), key);
        }
        publish(&mut follower, 50, 0, 0.0);
        publish(&mut follower, 100, 0, 0.0);
        publish(&mut follower, 250, 0, 0.0);
        let decisions = &follower.into_decisions()[&4];
        assert_eq!((decisions.count, &decisions.ages_s[..]), (6, &[0.04, 0.09][..]));
    }
}
