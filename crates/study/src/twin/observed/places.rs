//! Places of the robots of a recorded run over time, by the hosts that are on them.

use super::{Log, ObservedTeam};
use murmurate::messages::ids::{HostId, RobotId};

/// Longest time for which a robot counts as being where it was last seen \[ns\].
const LONGEST_NS: i64 = 1_000_000_000;

/// Places of the robots of a recorded run.
pub(super) struct Places {
    /// First robot of each host; `None` for a host without robots.
    robots_of: Vec<Option<usize>>,
    /// Times \[ns\] and positions \[m\] of each robot, in the order of the times.
    seen: Vec<Vec<(i64, [f64; 2])>>,
}

impl Places {
    /// Returns the true places of a team's robots, or, if its records have none, those that they believed.
    pub fn of_team(logs: &[Log], common: &impl Fn(usize, i64) -> Option<i64>, team: &ObservedTeam) -> Places {
        let hosts: Vec<HostId> = RobotId::team(team.robots).map(|robot| team.routes.agent_host(robot)).collect();
        let first = |host: u16| hosts.iter().position(|other| *other == HostId(host));
        let mut places =
            Places { robots_of: (0..team.hosts as u16).map(first).collect(), seen: vec![Vec::new(); team.robots] };
        let is_true = logs.iter().any(|log| !log.states.is_empty());
        for (at, log) in logs.iter().enumerate() {
            for state in &log.states {
                places.see(state.robot, common(at, state.at_ns), state.place);
            }
            for latent in log.sent.iter().filter(|_| !is_true).filter_map(|sent| Some((sent, sent.latent.as_ref()?))) {
                let (sent, latent) = latent;
                let position = latent.motion.position;
                places.see(latent.robot.index(), common(at, sent.at_ns), [position.x, position.y].map(f64::from));
            }
        }
        places.sorted()
    }

    /// Returns the measured places of the robots of an imported run, whose hosts have their numbers.
    pub fn of_import(log: &Log, robots: usize) -> Places {
        let mut places = Places { robots_of: (0..robots).map(Some).collect(), seen: vec![Vec::new(); robots] };
        for state in &log.states {
            places.see(state.robot, Some(state.at_ns), state.place);
        }
        places.sorted()
    }

    fn see(&mut self, robot: usize, at_ns: Option<i64>, place: [f64; 2]) {
        if let (Some(at_ns), Some(seen)) = (at_ns, self.seen.get_mut(robot)) {
            seen.push((at_ns, place));
        }
    }

    fn sorted(mut self) -> Places {
        self.seen.iter_mut().for_each(|seen| seen.sort_by_key(|(at_ns, _)| *at_ns));
        self
    }

    /// Returns the distance between the robots of two hosts at a time \[m\]; `None` if one of them was not seen.
    pub fn between(&self, from: HostId, to: HostId, at_ns: i64) -> Option<f32> {
        let place = |host: HostId| {
            let seen = &self.seen[(*self.robots_of.get(usize::from(host.0))?)?];
            let (last_ns, place) = seen[..seen.partition_point(|(ns, _)| *ns <= at_ns)].last()?;
            (at_ns - last_ns <= LONGEST_NS).then_some(*place)
        };
        let ([x, y], [far_x, far_y]) = (place(from)?, place(to)?);
        Some((far_x - x).hypot(far_y - y) as f32)
    }
}
