//! Opens the drivers and the source of readings of one host for a while, collects all that they report, and runs a
//! wiggle (a short drive of each robot) if requested.

use std::cell::{Cell, RefCell};
use std::io::Read;
use std::rc::Rc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::Result;
use murmurate::actors::wiggle;
use murmurate::deploy::Host;
use murmurate::deploy::team::Team;
use murmurate::flight::LANDING;
use murmurate::graph::bench::{self, Bench, Event};
use murmurate::graph::devices::{self, DeviceError, Devices, Workers};
use murmurate::graph::event;
use murmurate::graph::operator::{self, Operator};
use murmurate::messages::wire::{Stop, Wire};
use murmurate::registry::Registry;
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::run_real;
use murmurate::time::{Span, Time};

use super::devices::Seen;
use super::listen::hindrance;
use super::{host_of, notes};
use crate::{BadInput, signals};

/// Time for which commands to stand are still sent to the robots, before the check of the devices ends.
const STOPPING: Span = Span::from_millis(200);

/// Longest time for the drivers and the source to start, in addition to the listening time. Discovery of ROS 2 takes
/// 1.3 s, and the SDK of a RoboMaster one second.
const STARTING: Span = Span::from_millis(3000);

/// Reason why the check of a host's drivers and source ended.
pub enum End {
    /// The listening time is over, or the wiggle has its last result.
    Done,
    /// The user or the system interrupted the program by Ctrl-C or SIGTERM.
    Interrupted,
    /// The team has an emergency stop or an episode, as the text says, so no robot may be driven.
    Team(String),
}

/// Opens the drivers and the source of the host `team.host`, and observes them for `seconds` \[s\] after their first
/// report. Then runs the wiggle (a short drive of each robot) if `wiggle` is given. Returns what the devices reported,
/// and why the check ended.
///
/// The operator in `wiggle` listens to the team; an emergency stop or an episode of the team ends the wiggle. It is
/// `None` if the host has no link. `tell` is called with a line of text when a robot begins to drive.
pub fn look(
    team: &Team,
    registry: &Registry,
    seconds: f64,
    wiggle: Option<(wiggle::Config, Option<Operator>)>,
    tell: fn(&str),
) -> Result<(Seen, End)> {
    let host = host_of(team);
    let (devices, workers) = open(host, team.deployment.robots, registry)?;
    let (signal, wake_reader) = signals::listen()?;
    notes::take(true);
    let seen = Rc::new(RefCell::new(Seen::new(!host.localizes.is_empty(), Span::from_secs(team.safety.own_state_s))));
    let stopped = Rc::new(RefCell::new(None));
    let (length, latest) = (Span::from_secs(seconds), Time::ZERO + Span::from_secs(seconds) + STARTING);
    let wiggles = wiggle.is_some();
    let (stopping, begun): (Cell<Option<Time>>, Cell<bool>) = Default::default();
    let (noted, heard) = (Rc::clone(&seen), Rc::clone(&stopped));
    run_real(
        Instant::now(),
        |clock, readers| {
            let (config, operator) = wiggle.map_or((None, None), |(config, operator)| (Some(config), operator));
            let time = clock.clone();
            let report = move |event: Event| {
                if let Event::Begins(robot) = &event {
                    tell(&format!("{robot} drives 10 cm, and back"));
                }
                noted.borrow_mut().note(time.now(), event);
            };
            let of = (&team.deployment, team.host, &team.estimator);
            let bench = bench::wire((clock, readers), of, &devices, config, report);
            drop(devices);
            if let Some(operator) = operator {
                operator::wire((clock, readers), operator, move |said| {
                    if let Some(reason) = reason_to_end(&said) {
                        heard.borrow_mut().get_or_insert(reason);
                    }
                });
            }
            let source = Rc::clone(&wake_reader);
            readers.watch(wake_reader, move || {
                let _ = (&*source).read(&mut [0; 16]);
            });
            tick(clock);
            bench
        },
        |bench: &Rc<Bench>, now| {
            let looked = now >= seen.borrow().began.map_or(latest, |began| latest.min(began + length));
            if looked && wiggles && !begun.replace(true) {
                bench.begin();
            }
            let over = if wiggles { seen.borrow().over } else { looked };
            let ends = over || signal.load(Ordering::Relaxed) != 0 || stopped.borrow().is_some();
            if ends && stopping.get().is_none() {
                stopping.set(Some(now));
                seen.borrow_mut().end(now);
                notes::take(false);
                bench.leave();
            }
            let down = |since: Span| since >= STOPPING && (!bench.is_airborne() || since >= LANDING);
            stopping.get().is_some_and(|at| down(now.since(at)))
        },
    );
    workers.join();
    let end = match (stopped.take(), signal.load(Ordering::Relaxed)) {
        (Some(reason), _) => End::Team(reason),
        (None, 0) => End::Done,
        (None, _) => End::Interrupted,
    };
    Ok((seen.take(), end))
}

/// Opens the drivers and the source of a host, and starts their workers. It publishes nothing for other programs.
fn open(host: &Host, robots: usize, registry: &Registry) -> Result<(Devices, Workers)> {
    let quiet = Host { observe: None, ..host.clone() };
    devices::open(&quiet, robots, registry).map_err(|error| match error {
        DeviceError::Config(error) => BadInput(error.to_string()).into(),
        DeviceError::Machine(_) | DeviceError::InUse(_) => error.into(),
    })
}

/// Returns the reason to end a wiggle that follows from an event of the operator that listens to the team: an emergency
/// stop or an episode. `None` if the event is no reason.
fn reason_to_end(said: &event::Event) -> Option<String> {
    match said {
        event::Event::Message(Wire::Mode(mode)) => hindrance(mode.phase, mode.latch),
        event::Event::Message(Wire::Stop(stop)) => hindrance_of_stop(stop),
        _ => None,
    }
}

/// Wakes the event loop every 50 ms, so that time limits are noticed.
fn tick(clock: &Clock) {
    let again = clock.clone();
    clock.call(clock.now() + Span::from_millis(50), Box::new(move || tick(&again)));
}

/// Returns the reason why no robot may be driven after the emergency stop message `stop`; `None` if the message says
/// that the stop is clear.
fn hindrance_of_stop(stop: &Stop) -> Option<String> {
    (!stop.latch.is_clear()).then(|| "the emergency stop was engaged".to_owned())
}
