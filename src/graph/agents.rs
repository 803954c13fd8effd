//! Agents as a trial makes them: their policies, and how long a step waits.

use std::sync::Arc;

use crate::actors::agent::{Agent, RobotPolicies};
use crate::messages::ids::RobotId;
use crate::net::protocol::parts::Settings;
use crate::policy::{Interface, Model};
use crate::time::Span;
use crate::trial::Trial;

/// Policy that drives the robots to their starts before an episode.
const RESET: Model = Model::Orca;

/// Returns the longest time for which a joint step of an Agent waits for late percepts.
pub(super) fn max_wait(trial: &Trial) -> Span {
    Span::from_nanos(trial.model.interface().period.as_nanos() / 4)
}

/// Makes an Agent of `robots`, which are in the order of their ids, at the start number `incarnation` of the actor.
pub(super) fn agent_of(trial: &Trial, robots: &[RobotId], incarnation: u32) -> Agent {
    let seed = trial.streams();
    let policies = |&robot: &RobotId| {
        // A policy sees the commanded point, so the hull of a differential drive is wider for it.
        let arena = trial.scenario.arena().about_point(trial.deployment.chassis(robot).point_ahead_m);
        RobotPolicies {
            robot,
            dynamics: trial.dynamics(robot),
            channels: trial.channels().unwrap_or_else(|error| panic!("the policy was checked: {error}")),
            run: trial.model.instance(&arena),
            reset: RESET.instance(&arena),
            actions: seed.stream(&format!("agent/{}/action/{incarnation}", robot.0)),
            ranges: seed.stream(&format!("agent/{}/range/{incarnation}", robot.0)),
        }
    };
    let robots = robots.iter().map(policies).collect();
    Agent::new(Arc::clone(&trial.scenario), trial.comm_range(), max_wait(trial), robots)
}

/// Returns the longest times until the answer of a worker that computes an Agent's policies: from the step, after which
/// the next one is near, and from the control tick, after which the guard takes no action any more.
pub(super) fn deadlines(trial: &Trial) -> [Span; 2] {
    let half = Span::from_nanos(trial.model.interface().period.as_nanos() / 2);
    [half, Span::from_secs(0.8 * trial.safety.late_tick_s)]
}

/// Returns how messages of a policy travel in parts; `None` if they fit into a datagram.
pub(super) fn parts_of(model: &Model) -> Option<Settings> {
    let (Interface { features, period, .. }, form) = (model.interface(), model.form());
    form.is_in_parts(features).then(|| Settings { form, floats: features, period, policy: model.mark() })
}
