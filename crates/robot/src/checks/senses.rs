//! Findings of `doctor` about the senses of a host's robots: starts their workers, such as programs of the user, and
//! reports what they put out.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use murmurate::config::shown::counted;
use murmurate::deploy::team::Team;
use murmurate::edge::{self, Gate, WorkerState};
use murmurate::fitness::Fitness;
use murmurate::messages::ids::RobotId;
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::run_real;
use murmurate::senses::{In, Out, Sense, Site};
use murmurate::time::{Span, Time};

use super::finding::{Found, Subject};
use super::{host_of, notes};
use crate::{signals, team};

/// Longest time for a sense to put out its first values, in addition to the listening time.
const STARTING: Span = Span::from_millis(5000);
/// Longest time for all workers together to end.
const PATIENCE: Duration = Duration::from_secs(1);

/// Sense of one robot, and what it has put out.
struct Heard {
    robot: RobotId,
    name: String,
    sense: Box<dyn Sense>,
    /// Number of values that its form has.
    floats: usize,
    outputs: Vec<Out>,
    /// Number of measurements, with the times of the first and the last one; `None` before the first.
    measured: Option<(u32, Time, Time)>,
    /// Number of outputs that cannot be used, by the reason.
    refused: BTreeMap<String, u32>,
    /// Number of times that the worker has ended.
    ends: u32,
}

impl Heard {
    /// Returns the name of the worker's thread, under which its warnings are collected.
    fn thread(&self) -> String {
        format!("{} {}", self.name, self.robot.0)
    }

    /// Takes a packet of the worker.
    fn take(&mut self, now: Time, packet: &[u8]) {
        self.sense.take(now, In::Packet(packet), &mut self.outputs);
        for output in std::mem::take(&mut self.outputs) {
            match output {
                Out::Values { values, .. } if values.len() == self.floats => {
                    let (count, first, _) = self.measured.unwrap_or((0, now, now));
                    self.measured = Some((count + 1, first, now));
                }
                Out::Values { values, .. } => {
                    self.refuse(&format!("it puts out {}, and its form has {}", values.len(), self.floats));
                }
                Out::Refused(why) => self.refuse(why),
            }
        }
    }

    fn refuse(&mut self, why: &str) {
        *self.refused.entry(why.to_owned()).or_default() += 1;
    }

    /// Returns the finding about the sense. `notes` are the warnings of its worker.
    fn finding(&self, notes: &[String]) -> Found {
        let what = Subject::General(format!("{}, sense {}", self.robot, self.name));
        let refused =
            self.refused.iter().map(|(why, count)| format!("{} refused: {why}", counted(*count as usize, "line")));
        let ends = (self.ends > 0).then(|| format!("it has ended {}", counted(self.ends as usize, "time")));
        let wrong: Vec<String> = refused.chain(ends).chain(notes.iter().cloned()).collect();
        match self.measured {
            None => {
                let said = ["no values".to_owned()].into_iter().chain(wrong).collect::<Vec<_>>().join("; ");
                let advice = "does what it takes its values from run, and put out one for each measurement?";
                (Fitness::Fail, what, said, advice.to_owned())
            }
            Some((count, first, last)) => {
                let seconds = last.since(first).as_secs();
                let rate = if seconds > 0.0 { f64::from(count - 1) / seconds } else { 0.0 };
                let form = counted(self.floats, "value");
                let said = format!("{form}, {rate:.1} measurements a second");
                let status = if wrong.is_empty() { Fitness::Ok } else { Fitness::Warn };
                (status, what, [said].into_iter().chain(wrong).collect::<Vec<_>>().join("; "), String::new())
            }
        }
    }
}

/// Starts the workers of the senses of all robots whose Bodies the host `team.host` runs, observes them for `seconds`
/// \[s\] after each has put out its first values, and returns a finding about each sense. Simulated senses have no
/// worker, and are left out.
pub fn look(team: &Team, registry: &Registry, seconds: f64) -> Result<Vec<Found>> {
    let (host, scenario) = (host_of(team), team::scenario(team, registry)?);
    let (mut gates, mut running, mut all) = (Vec::new(), Vec::new(), Vec::new());
    notes::take(true);
    for robot in host.simulates.iter().chain(&host.actuates).copied().map(RobotId) {
        for (_, name, settings) in team.deployment.senses_of(robot) {
            let parts = registry.sense(name, settings, robot).map_err(|error| error.within("senses"))?;
            let Some(worker) = parts.worker else { continue };
            worker.check().map_err(|error| error.within(name).within("senses"))?;
            let stream = Seed::of_run(0).stream("doctor");
            let heard = Heard {
                robot,
                name: name.to_owned(),
                sense: (parts.sense)(Site { robot, arena: scenario.arena(), stream }),
                floats: parts.layout.floats(),
                outputs: Vec::new(),
                measured: None,
                refused: BTreeMap::new(),
                ends: 0,
            };
            let (gate, worker) = edge::start(worker, &heard.thread()).context("a sense's worker cannot be started")?;
            gates.push(gate);
            running.push(worker);
            all.push(Rc::new(RefCell::new(heard)));
        }
    }
    if all.is_empty() {
        return Ok(Vec::new());
    }
    observe(gates, &all, Span::from_secs(seconds))?;
    notes::take(false);
    let begun = Instant::now();
    for worker in running {
        // A worker that does not end goes with this process.
        let _ = worker.join(PATIENCE.saturating_sub(begun.elapsed()));
    }
    Ok(all
        .iter()
        .map(|heard| heard.borrow().finding(&notes::of_sense(heard.borrow().robot, &heard.borrow().thread())))
        .collect())
}

/// Passes the packets of the workers to their senses, until each has been heard for the time `length`, the time for the
/// first values is over, or a signal ends the program. Closes the channels to the workers.
fn observe(gates: Vec<Gate>, all: &[Rc<RefCell<Heard>>], length: Span) -> Result<()> {
    let (signal, wake_reader) = signals::listen()?;
    let latest = Time::ZERO + STARTING + length;
    run_real(
        Instant::now(),
        |clock, readers| {
            for (gate, heard) in gates.into_iter().zip(all) {
                let (gate, heard, time) = (RefCell::new(gate), Rc::clone(heard), clock.clone());
                let bell = Rc::new(gate.borrow().bell());
                let over = Cell::new(false);
                readers.watch(bell, move || {
                    let state = gate.borrow_mut().take(|packet| heard.borrow_mut().take(time.now(), &packet));
                    let ends = state == WorkerState::Restarted || state == WorkerState::Ended && !over.replace(true);
                    heard.borrow_mut().ends += u32::from(ends);
                });
            }
            signals::watch(readers, wake_reader);
            tick(clock);
        },
        |(), now| {
            let heard = |heard: &Rc<RefCell<Heard>>| {
                heard.borrow().measured.is_some_and(|(_, first, _)| now.since(first) >= length)
            };
            now >= latest || all.iter().all(heard) || signal.load(Ordering::Relaxed) != 0
        },
    );
    Ok(())
}

/// Wakes the event loop every 50 ms, so that time limits are noticed.
fn tick(clock: &Clock) {
    let again = clock.clone();
    clock.call(clock.now() + Span::from_millis(50), Box::new(move || tick(&again)));
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use murmurate::deploy::team::TeamFile;
    use murmurate::messages::ids::HostId;

    use super::*;

    /// Returns the findings about a sense of two values of the unit 1, by this script of a shell.
    fn findings(script: &str) -> Vec<Found> {
        let sense = format!("[senses.eyes]\nkind = \"program\"\ncommand = [\"sh\", \"-c\", '{script}']\nshape = [2]");
        let text = format!("team = 1\nmode = \"sim\"\nrobots = 2\n{sense}\nunit = \"1\"\n");
        let file = TeamFile::read(&crate::registry(), &text, Path::new(""), &[], &[]).expect("it is valid");
        look(&file.for_host(HostId(0)).expect("its host"), &crate::registry(), 0.3).expect("it can be made")
    }

    #[test]
    fn a_sense_is_fit_if_its_program_prints_its_values() {
        const LINE: &str = "echo \"{\\\"stamp_s\\\": 1, \\\"values\\\": [1, null]}\"";
        let found = findings(&format!("while {LINE}; do sleep 0.05; done"));
        assert_eq!(found.len(), 2, "one of each robot");
        let (status, what, said, _) = &found[1];
        assert_eq!((*status, what.to_string()), (Fitness::Ok, "robot 1, sense eyes".to_owned()), "{said}");
        assert!(said.starts_with("2 values, ") && said.ends_with("measurements a second"), "{said}");
        let (status, _, said, _) = &findings(&format!("while {LINE}; do echo 1; sleep 0.05; done"))[0];
        assert!(*status == Fitness::Warn && said.contains("lines refused: it is not a line"), "{said}");
    }

    #[test]
    fn a_sense_whose_program_prints_nothing_or_another_form_is_not_fit() {
        let (status, _, said, advice) = &findings("sleep 60")[0];
        assert!(*status == Fitness::Fail && said == "no values" && advice.contains("put out one for each"), "{said}");
        let (status, _, said, _) = &findings("echo \"{\\\"stamp_s\\\": 1, \\\"values\\\": [1]}\"; sleep 60")[0];
        assert!(*status == Fitness::Fail && said.contains("it puts out 1, and its form has 2"), "{said}");
    }
}
