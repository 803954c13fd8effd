//! Agents as a trial makes them: their policies, and how long a step waits.

use std::sync::Arc;

use crate::actors::agent::{Agent, RobotPolicies};
use crate::messages::ids::RobotId;
use crate::net::protocol::parts::Settings;
use crate::policy::{Model, Models};
use crate::time::Span;
use crate::trial::Trial;

/// Policy that drives the robots to their starts before an episode.
const RESET: Model = Model::Orca;

/// Returns the longest time for which a joint step of an Agent of `robots` waits for late percepts.
pub(super) fn max_wait(trial: &Trial, robots: &[RobotId]) -> Span {
    Span::from_nanos(trial.models.tick(robots).as_nanos() / 4)
}

/// Makes an Agent of `robots`, which are in the order of their ids, at the start number `incarnation` of the actor.
pub(super) fn agent_of(trial: &Trial, robots: &[RobotId], incarnation: u32) -> Agent {
    let (seed, tick) = (trial.streams(), trial.models.tick(robots));
    let policies = |&robot: &RobotId| {
        // A policy sees the commanded point, so the hull of a differential drive is wider for it.
        let arena = trial.scenario.arena().about_point(trial.deployment.chassis(robot).point_ahead_m);
        RobotPolicies {
            robot,
            dynamics: trial.dynamics(robot),
            range: trial.comm_range(robot),
            point_ahead_m: trial.deployment.chassis(robot).point_ahead_m,
            every: trial.models.every(robot, tick),
            channels: trial.channels(robot).unwrap_or_else(|error| panic!("the policy was checked: {error}")),
            run: trial.models.of(robot).instance(&arena, robot),
            reset: RESET.instance(&arena.at(None), robot),
            actions: seed.stream(&format!("agent/{}/action/{incarnation}", robot.0)),
            resets: seed.stream(&format!("agent/{}/reset/{incarnation}", robot.0)),
            ranges: seed.stream(&format!("agent/{}/range/{incarnation}", robot.0)),
        }
    };
    let wait = max_wait(trial, robots);
    let robots = robots.iter().map(policies).collect();
    let between = trial.deployment.between_latents();
    Agent::new(Arc::clone(&trial.scenario), wait, robots).with_layouts(trial.layouts.clone()).broadcasting(between)
}

/// Returns the longest times until the answer of a worker that computes the policies of an Agent of `robots`: from the
/// step, after which the next one is near, and from the control tick, after which the guard takes no action any more.
pub(super) fn deadlines(trial: &Trial, robots: &[RobotId]) -> [Span; 2] {
    let half = Span::from_nanos(trial.models.tick(robots).as_nanos() / 2);
    [half, Span::from_secs(0.8 * trial.safety.late_tick_s)]
}

/// Returns how messages of a team's policies travel in parts; `None` if they fit into a datagram.
pub(super) fn parts_of(models: &Models) -> Option<Settings> {
    let (floats, period, form) = (models.features(), models.period(), models.form());
    form.is_in_parts(floats).then(|| Settings { form, floats, period, policy: models.mark() })
}
