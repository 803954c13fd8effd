//! Injection of planned faults, at times from the start of the trial or of an episode.

use std::rc::Rc;

use super::Plan;
use super::process::Graph;
use crate::faults::ActorFault;
use crate::net::transport;
use crate::runtime::clock::Clock;
use crate::time::Time;

/// Schedules the planned faults in `plan.faults`. Faults of actors are injected at their times from the start of the
/// trial or of an episode. Emulated links inject link faults themselves, and get a notice when an episode with such
/// faults begins.
pub(super) fn schedule(clock: &Clock, plan: &Rc<Plan>, graph: &Rc<Graph>) {
    for fault in plan.faults.actors.iter().filter(|fault| fault.episode.is_none()) {
        inject(clock, graph, fault, fault.at);
    }
    // A weak reference, because the graph holds this listener.
    let (later, plan, weak) = (clock.clone(), Rc::clone(plan), Rc::downgrade(graph));
    let began = move |episode| {
        let Some(graph) = weak.upgrade() else { return };
        for fault in plan.faults.actors.iter().filter(|fault| fault.episode == Some(episode)) {
            inject(&later, &graph, fault, later.now() + fault.at.since(Time::ZERO));
        }
        for (link, transport) in plan.deployment.links.iter().zip(&*graph.transports) {
            if plan.faults.of_link(&link.name).iter().any(|fault| fault.episode == Some(episode)) {
                transport.send(transport::In::EpisodeBegins(episode));
            }
        }
    };
    graph.episodes.listen(began);
}

fn inject(clock: &Clock, graph: &Rc<Graph>, fault: &ActorFault, at: Time) {
    let (fault, graph) = (fault.clone(), Rc::clone(graph));
    clock.call(at, Box::new(move || graph.inject(fault)));
}
