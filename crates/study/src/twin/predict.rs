//! Prediction of a twin: runs one repeat of its simulation, and collects the same data as from a record.

use std::cell::RefCell;
use std::rc::Rc;

use super::ages::{Decisions, Follower, Rules};
use murmurate::graph::event::Event;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::{Kind, Wire};
use murmurate::net::protocol::codec::{self, Content, Frame};
use murmurate::results::episode::Episode;
use murmurate::simulate::Proceed;
use murmurate::trial::Trial;
use murmurate_record::clocks;

/// Results of one simulated repeat of a twin's prediction.
#[derive(Clone, Debug)]
pub struct Predicted {
    /// Results of the simulated episodes.
    pub episodes: Vec<Episode>,
    /// Robots' decisions in each simulated episode, with the ages of the messages that they used.
    pub decisions: Vec<Decisions>,
}

/// What becomes of a latent's datagram in the simulation.
enum Passage {
    Published(Frame),
    Arrived(HostId, Frame),
}

/// Returns the rules by which the robots of a trial use neighbours' messages: range, hold time and handling.
pub fn rules(trial: &Trial) -> Rules {
    let hold = trial.models.hold();
    Rules { range_m: trial.comm_range(RobotId(0)).mean_m, hold_ns: hold.as_nanos() as i64, handling: trial.handling }
}

/// Returns the host of each robot's agent in a trial, in the order of the robots.
pub fn hosts(trial: &Trial) -> Vec<HostId> {
    let routes = murmurate::deploy::Routes::of(&trial.deployment);
    RobotId::team(trial.deployment.robots).map(|robot| routes.agent_host(robot)).collect()
}

/// Runs the trial until its end, and returns its results and decisions; `None` if it did not finish. `proceed` is
/// called with the results of the episodes so far, and says whether the trial goes on.
pub fn run(trial: &Trial, mut proceed: impl FnMut(&[Episode]) -> Proceed) -> Option<Predicted> {
    let mut follower = Follower::new(rules(trial), hosts(trial));
    let events: Rc<RefCell<Vec<Passage>>> = Rc::default();
    let heard = Rc::clone(&events);
    let is_latent = |frame: &Frame| matches!(codec::first(frame), Ok(Content::Message(Kind::Latent)));
    let report = trial.run_observed(
        move |_, host, event| match event {
            Event::Published(frame) if is_latent(frame) => {
                heard.borrow_mut().push(Passage::Published(Frame::clone(frame)));
            }
            Event::Arrived(_, frame) if is_latent(frame) => {
                heard.borrow_mut().push(Passage::Arrived(host, Frame::clone(frame)));
            }
            _ => {}
        },
        |_, now, episodes| {
            let now_ns = now.as_nanos() as i64;
            for event in events.borrow_mut().drain(..) {
                match event {
                    Passage::Published(frame) => {
                        if let (Some(key), Ok((_, Wire::Latent(latent)))) = (clocks::key(&frame), codec::decode(&frame))
                        {
                            follower.publish(now_ns, key, &latent);
                        }
                    }
                    Passage::Arrived(host, frame) => {
                        clocks::key(&frame).iter().for_each(|key| follower.arrive(now_ns, host, key));
                    }
                }
            }
            proceed(episodes)
        },
    );
    let mut decisions = follower.into_decisions();
    let decisions = (0..trial.layouts.len()).map(|episode| decisions.remove(&episode).unwrap_or_default()).collect();
    report.finished.then_some(Predicted { episodes: report.episodes, decisions })
}
