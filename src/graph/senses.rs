//! Wiring of the senses of robots.

use std::rc::Rc;

use tracing::info_span;

use super::process::Graph;
use crate::actors::network;
use crate::actors::senses::{Named, Senses};
use crate::messages::ids::RobotId;
use crate::messages::wire::Wire;
use crate::runtime::clock::Clock;
use crate::runtime::shell::start;
use crate::senses::Site;
use crate::trial::Trial;

/// Starts the Senses of one robot, the actor that publishes what the robot perceives, on the host of its Body. Does
/// nothing in a team without senses.
pub(super) fn wire_senses(clock: &Clock, trial: &Rc<Trial>, graph: &Graph, robot: RobotId) {
    let Some(mailbox) = graph.senses.get(robot.index()) else { return };
    let network = graph.network_of(graph.routes.actuator_host(robot));
    let (trial, seed) = (Rc::clone(trial), trial.streams());
    let make = move |incarnation| {
        let all = trial.senses(robot).unwrap_or_else(|error| panic!("the senses were checked: {error}"));
        let named = all.into_iter().map(|(index, name, parts)| {
            let stream = seed.stream(&format!("sense/{name}/{}/{incarnation}", robot.0));
            let sense = (parts.sense)(Site { robot, arena: trial.scenario.arena(), stream });
            Named { index, name, floats: parts.layout.floats(), sense }
        });
        Senses::new(robot, named.collect()).with_layouts(trial.layouts.clone())
    };
    start(clock, mailbox, info_span!("senses", robot = robot.0), make, move |sensed| {
        network.send(network::In::Publish(Wire::Sensed(sensed)));
    });
}
