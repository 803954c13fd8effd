//! Injection of planned faults, at times from the start of the trial or of an episode.

use std::rc::Rc;

use super::process::Graph;
use crate::faults::{ActorFault, ActorFaultKind};
use crate::net::media::ether;
use crate::runtime::clock::Clock;
use crate::time::Time;
use crate::trial::Trial;

/// Schedules the planned faults in `trial.faults`. Faults of actors are injected at their times from the start of the
/// trial or of an episode. Emulated links inject link faults themselves, and get a notice when an episode with such
/// faults begins.
pub(super) fn schedule(clock: &Clock, trial: &Rc<Trial>, graph: &Rc<Graph>) {
    for fault in trial.faults.actors.iter().filter(|fault| fault.episode.is_none()) {
        inject(clock, graph, fault, fault.at);
    }
    // A weak reference, because the graph holds this listener.
    let (later, trial, weak) = (clock.clone(), Rc::clone(trial), Rc::downgrade(graph));
    let began = move |episode| {
        let Some(graph) = weak.upgrade() else { return };
        for fault in trial.faults.actors.iter().filter(|fault| fault.episode == Some(episode)) {
            inject(&later, &graph, fault, later.now() + fault.at.since(Time::ZERO));
        }
        for (link, medium) in trial.deployment.links.iter().zip(&*graph.media) {
            if trial.faults.of_link(&link.name).iter().any(|fault| fault.episode == Some(episode)) {
                medium.send(ether::In::EpisodeBegins(episode));
            }
        }
    };
    graph.episodes.listen(began);
}

fn inject(clock: &Clock, graph: &Rc<Graph>, fault: &ActorFault, at: Time) {
    if fault.kind == ActorFaultKind::Flat {
        for (at, percent) in [(at, 0), (at + fault.lasts, 100)] {
            let (robot, graph) = (fault.robot, Rc::clone(graph));
            clock.call(at, Box::new(move || graph.charge(robot, percent)));
        }
        return;
    }
    let (fault, graph) = (fault.clone(), Rc::clone(graph));
    clock.call(at, Box::new(move || graph.inject(fault)));
}
