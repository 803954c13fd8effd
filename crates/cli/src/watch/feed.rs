//! Feed of the live page: publishes snapshots at 20 Hz (10 Hz of 400 robots or more), the status twice a second and on
//! changes, goals at each episode, and metrics once a second.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::{Duration, Instant};

use murmurate::time::Time;
use murmurate_view::metrics::Metrics;
use murmurate_view::server::Publisher;
use murmurate_view::status::PageStatus;
use murmurate_view::team_view::TeamView;

/// Period at which snapshots of all robots are published to pages.
const SNAPSHOT: Duration = Duration::from_millis(50);
/// Period of snapshots of a team with `LARGE` or more robots.
const SNAPSHOT_LARGE: Duration = Duration::from_millis(100);
/// Number of robots from which on snapshots are less frequent.
const LARGE: usize = 400;
/// Longest period between two publications of the status, if nothing in it changes.
const STATUS: Duration = Duration::from_millis(500);
/// Period at which the metrics are published.
const METRICS: Duration = Duration::from_secs(1);
/// Period at which the feed checks whether something has to be published.
const LOOK: Duration = Duration::from_millis(10);

/// State whose change is published at once: word for the emergency stop, number of robots that have confirmed it,
/// episode, and the state of this process.
type Change = (&'static str, usize, Option<u32>, &'static str);

/// Publisher of a team's state to browsers with the live page, and of the metrics if there are any.
pub struct Feed {
    view: Rc<RefCell<TeamView>>,
    metrics: Option<Rc<RefCell<Metrics>>>,
    metrics_at: Instant,
    period: Duration,
    snapshot_at: Instant,
    status_at: Instant,
    look_at: Instant,
    published: Option<Change>,
    goals_published: u64,
}

impl Feed {
    /// Returns a feed of the team's state `view` that has published nothing yet. It publishes metrics only if `metrics`
    /// is given.
    pub fn new(view: Rc<RefCell<TeamView>>, metrics: Option<Rc<RefCell<Metrics>>>) -> Feed {
        let now = Instant::now();
        let period = if view.borrow().scene().robots >= LARGE { SNAPSHOT_LARGE } else { SNAPSHOT };
        Feed {
            view,
            metrics,
            metrics_at: now,
            period,
            snapshot_at: now,
            status_at: now,
            look_at: now,
            published: None,
            goals_published: 0,
        }
    }

    /// Makes the next call of [`Feed::publish`] publish a snapshot of the robots without waiting for its period.
    pub fn at_once(&mut self) {
        (self.look_at, self.snapshot_at) = (Instant::now(), Instant::now());
    }

    /// Makes the next call of [`Feed::publish`] publish the status without waiting for its period, as something has
    /// happened.
    pub fn status_at_once(&mut self) {
        (self.look_at, self.status_at) = (Instant::now(), Instant::now());
    }

    /// Returns whether a status with this state of the process has been published.
    pub fn has_published(&self, own: &str) -> bool {
        self.published.is_some_and(|(.., published)| published == own)
    }

    /// Publishes snapshot, metrics, goals and status of the team if they are due, without waiting. `now` is the time of
    /// the run. A change of `own`, the state of this process in a word, is published at once. `fill` sets the fields of
    /// the status that only this process knows.
    pub fn publish(&mut self, publisher: &Publisher, now: Time, own: &'static str, fill: impl FnOnce(&mut PageStatus)) {
        let present = Instant::now();
        if present < self.look_at {
            return;
        }
        self.look_at = present + LOOK;
        let mut view = self.view.borrow_mut();
        if present >= self.snapshot_at {
            let snapshot = view.snapshot(now);
            self.metrics.iter().for_each(|metrics| metrics.borrow_mut().sample(&snapshot));
            let bytes = snapshot.encode(view.scene().scale_m);
            if publisher.snapshot(bytes) {
                self.snapshot_at = (self.snapshot_at + self.period).max(present);
            }
        }
        if let Some(metrics) = self.metrics.as_ref().filter(|_| present >= self.metrics_at)
            && publisher.metrics(metrics.borrow().text(&view))
        {
            self.metrics_at = present + METRICS;
        }
        if view.goals_changed() != self.goals_published {
            let (number, goals) = view.goals();
            if publisher.goals(goals.to_json()) {
                self.goals_published = number;
            }
        }
        let change = (view.latch().word(), view.confirmed(), view.phase().map(|(_, episode)| episode), own);
        if present < self.status_at && self.published == Some(change) {
            return;
        }
        let mut status = view.status(now);
        fill(&mut status);
        if publisher.status(status.to_json()) {
            (self.status_at, self.published) = (present + STATUS, Some(change));
        }
    }
}
