//! Topics of one robot as its DDS process reports them: who is connected, what is wrong, and whether two robots are
//! there. Does no I/O.

use std::collections::BTreeMap;

use murmurate::messages::ids::RobotId;

use super::packet::TopicState;

/// States of the topics of one robot.
#[derive(Debug)]
pub struct Topics {
    robot: RobotId,
    /// Topic of the robot's odometry; empty for a robot without odometry.
    odom: String,
    /// State of each topic that the DDS process has reported, by the name of the topic.
    states: BTreeMap<String, TopicState>,
    /// Number of new problems and of changes of peers that are worth a log line so far; it limits the log.
    problems: u64,
}

impl Topics {
    /// Makes the states of the topics of `robot`, of which nothing is known. `odom` is the topic of its odometry, empty
    /// if it has none.
    pub fn new(robot: RobotId, odom: String) -> Topics {
        Topics { robot, odom, states: BTreeMap::new(), problems: 0 }
    }

    /// Returns the topic of the robot's odometry; empty if it has none.
    pub fn odom(&self) -> &str {
        &self.odom
    }

    /// Records the state of a topic, and logs what is new in it.
    pub fn take(&mut self, state: TopicState) {
        let known = self.states.get(&state.topic);
        let robot = self.robot;
        // A problem of the participant concerns all topics, and is logged once.
        let new = state
            .problem
            .clone()
            .filter(|problem| self.states.values().all(|known| known.problem.as_ref() != Some(problem)));
        let lost = known.is_some_and(|known| known.peers > 0) && state.peers == 0;
        let several = state.peers > 1 && known.is_none_or(|known| known.peers != state.peers);
        // The DDS process names the topics of its plan alone, which are three at the most.
        let (topic, peers) = (state.topic.clone(), state.peers);
        let kind = if state.written { "subscribers" } else { "publishers" };
        self.states.insert(topic.clone(), state);
        if new.is_none() && !lost && !several {
            return;
        }
        self.problems += 1;
        // A hostile sender may change the state of a topic all the time.
        if self.problems >= 8 && !self.problems.is_power_of_two() {
            return;
        }
        if let Some(problem) = new {
            tracing::warn!(problems = self.problems, "{robot}: topic {topic}: {problem}");
        }
        if lost {
            tracing::warn!(
                "{robot}: topic {topic} has no subscriber or publisher left; see whether the robot's base runs"
            );
        }
        match self.twins().filter(|_| several) {
            Some(twins) => tracing::warn!("{robot}: {twins}; end one, or give it a namespace of its own"),
            None if several => tracing::warn!("{robot}: {peers} {kind} of {topic}: is one of them a second robot?"),
            None => {}
        }
    }

    /// Whether anyone subscribes to the robot's commands.
    pub fn is_obeyed(&self) -> bool {
        self.states.values().any(|state| state.written && state.peers > 0)
    }

    /// Returns the problem of a topic to which nobody is connected, with the topic; `None` if there is none.
    pub fn unmatched(&self) -> Option<String> {
        let refused = self.states.values().find(|state| state.peers == 0 && state.problem.is_some())?;
        Some(format!("{}: {}", refused.topic, refused.problem.as_ref()?))
    }

    /// Returns the newest problem of the robot's odometry, with its topic; `None` if there was none.
    pub fn problem_of_odometry(&self) -> Option<String> {
        let state = self.states.get(&self.odom)?;
        Some(format!("{}: {}", state.topic, state.problem.as_ref()?))
    }

    /// Returns the text about two robots that have this namespace: several publishers of the odometry and several
    /// subscribers of the commands, which would drive them both. `None` if they do not show. One of both alone may be a
    /// recorder, or a base that was started again a moment ago.
    pub fn twins(&self) -> Option<String> {
        let odom = self.states.get(&self.odom).filter(|state| state.peers > 1)?;
        let commands = self.states.values().find(|state| state.written && state.peers > 1)?;
        Some(format!(
            "{} publishers of {}, {} subscribers of {}: two robots have one namespace; both would be driven",
            odom.peers, odom.topic, commands.peers, commands.topic
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_robots_in_one_namespace_show_by_both_their_topics() {
        let mut topics = Topics::new(RobotId(0), "/r0/odom".to_owned());
        let state = |topic: &str, peers| TopicState {
            topic: topic.to_owned(),
            written: topic.ends_with("vel"),
            peers,
            problem: None,
            refused: 0,
        };
        for (odom, commands, twins) in [(1, 1, false), (1, 2, false), (2, 1, false), (2, 2, true), (1, 1, false)] {
            topics.take(state("/r0/odom", odom));
            topics.take(state("/r0/cmd_vel", commands));
            assert_eq!(topics.twins().is_some(), twins, "{odom} {commands}");
        }
        topics.take(state("/r0/odom", 2));
        topics.take(state("/r0/cmd_vel", 2));
        let text = "2 publishers of /r0/odom, 2 subscribers of /r0/cmd_vel: two robots have one namespace; both would \
                    be driven";
        assert_eq!(topics.twins().as_deref(), Some(text));
    }
}
