//! State of a host that runs, for its outputs: results, counts, its record and its metrics.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::BTreeMap;

use crate::key::kept::Keeper;
#[cfg(feature = "watch")]
use crate::metrics::HostMetrics;
use crate::outlets::Outlets;
use crate::recording::LiveRecord;
use murmurate::actors::recorder::Out;
use murmurate::graph::event::Event;
use murmurate::graph::process::Graph;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::{Phase, Wire};
use murmurate::net::protocol::link::{DuplicateId, LinkCounts};
use murmurate::net::transport::Renewed;
use murmurate::report::TrialReport;
use murmurate::results::hardware::RobotHardware;
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::{Span, Time};
use murmurate_report::event::{Counted, HostEvent, RobotSafety, Unwritten};
use murmurate_report::heard::Heard;

/// State of a running host, which is collected for its outputs: results, counts, record and metrics.
pub struct Seen {
    /// Report of the trial, if this host judges it: results of its episodes and totals.
    pub report: RefCell<TrialReport>,
    /// Whether the state server has said that all episodes are finished.
    pub over: Cell<bool>,
    /// Number of messages that the host's actors have published.
    pub messages: Cell<u64>,
    /// Counters of the host's datagrams and messages on all links: sent, accepted, and refused by cause.
    pub counts: Cell<LinkCounts>,
    /// For each robot, the numbers of stops and reduced velocities by its guard, by cause.
    pub safety: RefCell<BTreeMap<RobotId, SafetyCounts>>,
    /// Condition of the hardware of each real robot that the host drives, as its driver reported it.
    pub hardware: RefCell<BTreeMap<RobotId, RobotHardware>>,
    /// Hosts that this host hears and its way of sending, as its Network said last; `None` without a mesh or a link
    /// that chooses.
    pub heard: RefCell<Option<Heard>>,
    /// Outputs of the host: stdout, trajectories and service manager.
    pub outlets: Outlets,
    /// Names of the deployment's links, by id.
    pub links: Vec<String>,
    /// Finding that another live host has the id of this one and started earlier; `None` if there is none.
    pub duplicate: Cell<Option<DuplicateId>>,
    /// Writer of rosters, in a team whose members have keys of their own.
    pub keeper: Option<Keeper>,
    /// Record of the run. It is `None` if nothing is recorded, and empty until the host begins.
    pub record: OnceCell<Option<LiveRecord>>,
    /// Metrics of the host. They are `None` if they are not served, and empty until the host begins.
    #[cfg(feature = "watch")]
    pub metrics: OnceCell<Option<HostMetrics>>,
}

impl Seen {
    /// Returns the state of a host that has not begun. `outlets` are its outputs, and `links` the names of the
    /// deployment's links, and `keeper` writes rosters.
    pub fn new(outlets: Outlets, links: Vec<String>, keeper: Option<Keeper>) -> Seen {
        let (report, over, messages, counts) = Default::default();
        let (safety, hardware, duplicate) = Default::default();
        Seen {
            report,
            over,
            messages,
            counts,
            safety,
            hardware,
            heard: RefCell::default(),
            outlets,
            links,
            duplicate,
            keeper,
            record: OnceCell::new(),
            #[cfg(feature = "watch")]
            metrics: OnceCell::new(),
        }
    }

    /// Returns the record of the run; `None` if nothing is recorded.
    pub fn record(&self) -> Option<&LiveRecord> {
        self.record.get()?.as_ref()
    }

    /// Marks the end of a turn of the event loop (one pass over all pending inputs), at the time `now`, in the record
    /// and the metrics. `steps` is the number of things that the host's actors have done so far; `None` before its
    /// first turn.
    pub fn end_turn(&self, now: Time, steps: Option<u64>) {
        #[cfg(feature = "watch")]
        if let Some(Some(metrics)) = self.metrics.get() {
            metrics.turn(now, self.record().map(LiveRecord::dropped));
        }
        self.record().into_iter().for_each(|record| record.turn(now, steps));
    }

    /// Updates the state with an event of the host `host`, and passes the event to the record and the metrics.
    pub fn receive(&self, host: HostId, heard: Event) {
        self.record().into_iter().for_each(|record| record.push(host, heard));
        #[cfg(feature = "watch")]
        if let Some(Some(metrics)) = self.metrics.get() {
            metrics.receive(host, heard);
        }
        match heard {
            Event::Message(Wire::Mode(mode)) if mode.phase == Phase::EpisodesFinished => self.over.set(true),
            Event::Message(_)
            | Event::Arrived(..)
            | Event::Perceived(..)
            | Event::Radio(..)
            | Event::Sent(..)
            | Event::Input(_)
            | Event::Refused(..)
            | Event::Truth(_)
            | Event::Members(_)
            | Event::Remembered(_)
            | Event::Recorded(_) => {}
            Event::Roster(number, sealed) => self.keeper.iter().for_each(|keeper| keeper.keep(number, sealed)),
            Event::Counts(counts) => self.counts.set(*counts),
            Event::Peers(peers, ways) => drop(self.heard.replace(Heard::of(peers, ways))),
            Event::Safety(robot, counts) => drop(self.safety.borrow_mut().insert(robot, counts)),
            Event::Hardware(robot, hardware) => {
                let mut all = self.hardware.borrow_mut();
                all.entry(robot).or_insert_with(|| RobotHardware::new(robot)).note(hardware);
            }
            Event::Published(_) => self.messages.set(self.messages.get() + 1),
            Event::Duplicate(duplicate) => self.duplicate.set(Some(duplicate)),
            Event::Aborted(episode, reason) => {
                self.outlets.print_event(&HostEvent::Aborted { episode, reason });
            }
            Event::Link(link, renewed) => {
                let (open, what) = match renewed {
                    Renewed::Open(at) => (true, at.clone()),
                    Renewed::Closed(why) => (false, why.clone()),
                };
                let link = self.links[usize::from(link.0)].clone();
                self.outlets.print_event(&HostEvent::Link { link, open, what });
            }
        }
    }

    /// Updates the results with an output of the Recorder, the actor that judges episodes. An output with the
    /// robots' states at one instant (`Out::Step`) goes to the trajectories file.
    pub fn note(&self, out: Out) {
        let mut report = self.report.borrow_mut();
        match out {
            Out::Step(step) => self.outlets.step(&step),
            other => report.note(other),
        }
        report.simulated = report.totals.end.since(Time::ZERO);
    }

    /// Returns all counts of the host so far: messages, datagrams, safety, hardware and dropped output.
    pub fn counted(&self, graph: &Graph) -> Counted {
        let (refused, lost) = graph.undelivered();
        let robot = |(&robot, &counts): (&RobotId, &SafetyCounts)| RobotSafety { robot, counts };
        Counted {
            messages: self.messages.get(),
            refused,
            lost,
            links: Box::new(self.counts.get()),
            oldest_command_s: self.report.borrow().totals.oldest_command.map(Span::as_secs),
            safety: self
                .safety
                .borrow()
                .iter()
                .filter(|(_, counts)| counts.reasons().next().is_some())
                .map(robot)
                .collect(),
            hardware: self.hardware.borrow().values().cloned().collect(),
            unwritten: Unwritten {
                record_events: self.record().map_or(0, LiveRecord::dropped),
                ..self.outlets.unwritten()
            },
        }
    }
}
