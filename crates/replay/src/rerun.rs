//! Replays a simulation from its record: runs it again from its seed.

use std::cell::RefCell;
use std::rc::Rc;

use murmurate::graph::event;
use murmurate::messages::ids::HostId;
use murmurate::simulate::Proceed;
use murmurate::time::Time;
use murmurate::trial::Trial;
use murmurate_record::compare::{Compared, Comparison};
use murmurate_record::reader::Messages;
use murmurate_record::topics::{Stage, Topics};
use murmurate_record::{Event, Scope};

use crate::ReplayError;
use crate::error::finish;

/// Runs a recorded simulation again, and compares it with the messages of its record. Calls `observe` with each event
/// of the run, and `turned` with the time of each instant after its events.
pub fn rerun(
    trial: &Trial,
    messages: Messages,
    observe: impl Fn(HostId, event::Event) + 'static,
    mut turned: impl FnMut(Time),
) -> Result<Compared, ReplayError> {
    let topics = Topics::new(Stage::of(trial), Scope::Simulation, 0);
    let comparison = Rc::new(RefCell::new(Comparison::new(messages, topics, 0)));
    let heard = Rc::clone(&comparison);
    trial.run_observed(
        move |_, host, event| {
            observe(host, event);
            if let Some(event) = Event::of(Scope::Simulation, host, event) {
                heard.borrow_mut().push(event);
            }
        },
        |_, now, _| {
            turned(now);
            let mut comparison = comparison.borrow_mut();
            comparison.push(Event::Turn(now));
            if comparison.is_over() { Proceed::Stop } else { Proceed::Continue }
        },
    );
    finish(comparison)
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate_record::file::Beginning;
    use murmurate_record::identity::Identity;
    use murmurate_record::queue::WhenFull;
    use murmurate_record::reader;
    use murmurate_record::series::Retention;
    use murmurate_record::writer::Recording;

    #[test]
    fn a_simulation_is_equal_to_its_record_and_one_of_another_seed_is_not() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.mcap");
        let trial = Trial::preset("offboard", "passage").unwrap();
        let topics = Topics::new(Stage::of(&trial), Scope::Simulation, 0);
        let beginning = Beginning { identity: Identity::here("1f", Vec::new(), ""), attached: Vec::new() };
        let kept = (WhenFull::Wait, Retention::default());
        let recording = Recording::start(&path, &beginning, topics, kept).unwrap();
        let (events, turns) = (recording.inlet(), recording.inlet());
        trial.run_observed(
            move |_, host, event| Event::of(Scope::Simulation, host, event).into_iter().for_each(|e| events.push(e)),
            |_, now, _| {
                turns.turn(now);
                Proceed::Continue
            },
        );
        recording.finish(None).unwrap();
        let again = |trial: &Trial| {
            let (_, messages) = reader::messages(&path).unwrap();
            let turned = Rc::new(RefCell::new(Time::ZERO));
            let latest = Rc::clone(&turned);
            let compared = rerun(trial, messages, |_, _| {}, move |now| *latest.borrow_mut() = now).unwrap();
            (compared, turned.take())
        };
        let (compared, last) = again(&trial);
        let difference = compared.difference.map(|difference| difference.to_string());
        assert_eq!(difference, None);
        assert!(compared.messages > 1000 && last > Time::from_nanos(1_000_000_000), "{}", compared.messages);
        let other = Trial { seed: trial.seed + 1, ..trial };
        assert!(again(&other).0.difference.is_some());
    }
}
