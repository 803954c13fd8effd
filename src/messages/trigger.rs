//! Safety triggers: the conditions for which a robot's guard stops or slows it. Their numbers are part of the wire
//! format.

use serde::{Deserialize, Serialize};

/// Condition for which a guard stops or slows its robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Trigger {
    /// The emergency stop is engaged, or the team is held after it. The guard stops the robot until an operator's
    /// resume and aborts a running episode.
    Stop,
    /// The state server, which leads the episodes, is silent. The guard stops the robot until the next message and
    /// aborts a running episode.
    Silence,
    /// The policy's output was not finite. The guard stops the robot until the state server's next instruction and
    /// aborts a running episode.
    Output,
    /// A control tick (periodic step of the policy) is late or missing, or its step has failed. The guard stops the
    /// robot until a tick is in time.
    LateTick,
    /// The newest reading of the robot's own state is too old. The guard stops the robot until a new reading has led to
    /// an action.
    OwnState,
    /// Battery or temperature is beyond its limit. The guard stops the robot while that lasts and aborts a running
    /// episode.
    Hardware,
    /// The robot is far outside its ground. The guard stops the robot while that lasts and aborts a running episode.
    Outside,
    /// The command would cross the geofence. The guard removes the outward component of the velocity.
    Fence,
    /// The command would violate the minimum distance to a neighbour. The guard removes the component of the velocity
    /// toward it.
    Distance,
    /// The command would violate the minimum distance to a wall. The guard removes the component of the velocity
    /// toward it.
    Walls,
    /// The robot's measured pose has jumped further than it can drive, so that nobody knows where it is. The guard
    /// stops the robot until its pose is known again and aborts a running episode.
    Jump,
    /// Messages of another robot about its own motion have contradicted the tracker. The guard keeps its distance
    /// from where that robot is measured, and neither stops nor slows its own robot for it.
    Claim,
}

impl Trigger {
    /// All triggers, in the order of their numbers.
    pub(crate) const ALL: [Trigger; 12] = [
        Trigger::Stop,
        Trigger::Silence,
        Trigger::Output,
        Trigger::LateTick,
        Trigger::OwnState,
        Trigger::Hardware,
        Trigger::Outside,
        Trigger::Fence,
        Trigger::Distance,
        Trigger::Walls,
        Trigger::Jump,
        Trigger::Claim,
    ];

    /// Returns the short name of the trigger for reports and pages, such as `late ticks`.
    pub fn name(self) -> &'static str {
        match self {
            Trigger::Stop => "emergency stops",
            Trigger::Silence => "server silent",
            Trigger::Output => "invalid outputs",
            Trigger::LateTick => "late ticks",
            Trigger::OwnState => "own state too old",
            Trigger::Hardware => "battery or temperature",
            Trigger::Outside => "far outside",
            Trigger::Fence => "geofence",
            Trigger::Distance => "minimum distance",
            Trigger::Walls => "walls",
            Trigger::Jump => "pose has jumped",
            Trigger::Claim => "another's false claims",
        }
    }
}

impl From<Trigger> for u8 {
    fn from(trigger: Trigger) -> u8 {
        trigger as u8
    }
}

impl TryFrom<u8> for Trigger {
    type Error = String;
    fn try_from(number: u8) -> Result<Trigger, String> {
        let trigger = Trigger::ALL.get(usize::from(number)).copied();
        trigger.ok_or_else(|| format!("no safety trigger has the number {number}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_means_the_trigger_that_was_converted_to_it() {
        assert!(Trigger::ALL.into_iter().all(|trigger| Trigger::try_from(u8::from(trigger)) == Ok(trigger)));
        assert!(Trigger::try_from(12).is_err());
    }
}
