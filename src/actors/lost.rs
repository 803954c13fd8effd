//! Robots whose poses are unknown, as a state server knows them from the hosts that measure them.

use std::collections::BTreeMap;

use crate::messages::ids::RobotId;
use crate::messages::place::Whereabouts;
use crate::messages::wire::Located;
use crate::results::episode::AbortCause;
use crate::time::{Span, Time};

/// Time without a message that a robot's pose is unknown after which it counts as known: five of their periods.
pub const LOST_FOR: Span = Span::from_millis(1000);

/// Robots whose poses are unknown, each with the reason and the arrival of the last message about it.
#[derive(Debug, Default)]
pub(super) struct Lost(BTreeMap<RobotId, (Whereabouts, Time)>);

impl Lost {
    /// Notes a message that arrived at time `now`, and logs what is new in it.
    pub(super) fn take(&mut self, now: Time, located: &Located) {
        for &(robot, whereabouts) in &located.robots {
            if !whereabouts.is_lost() {
                if self.0.remove(&robot).is_some() {
                    tracing::warn!("{robot}: its pose is known again");
                }
            } else if self.0.insert(robot, (whereabouts, now)).is_none_or(|(before, _)| before != whereabouts) {
                let (reason, remedy) = (whereabouts.reason(), whereabouts.remedy());
                tracing::error!("the team stands and waits for {robot}: {reason}; {remedy}");
            }
        }
    }

    /// Returns the robots whose poses are unknown at time `now` as causes of the end of an episode.
    pub(super) fn causes(&mut self, now: Time) -> Vec<(RobotId, AbortCause)> {
        self.0.retain(|_, (_, heard)| now.since(*heard) < LOST_FOR);
        self.0.keys().map(|robot| (*robot, AbortCause::PoseJumped)).collect()
    }
}
