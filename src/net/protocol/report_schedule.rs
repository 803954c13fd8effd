//! Schedule of report entries: reports have a byte budget, so hosts are listed in turn. Pure; sends nothing.
//!
//! Order of priority: candidates, which wait for an echo to prove their liveness; hosts that asked this one for a
//! proof; hosts whose proof gets old, to ask them for a new one; hosts whose loss has changed since it was last
//! reported; all others, the one listed longest ago first.

use super::bucket::{Bucket, Rate};
use super::candidates::{Candidate, Candidates};
use super::limits::{FRESH, LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE, PROOF_VALIDITY};
use super::report::Entry;
use super::sender::Sender;
use super::senders::Senders;
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Sustained budget of report entries \[bytes/s\]. With headers, tags and heartbeats a host stays below 1.5 kB/s of
/// soft state.
const ENTRY_BYTES_PER_S: f64 = 900.0;
/// Burst budget of report entries \[bytes\]. A team of 200 joins without waiting for the sustained rate.
const ENTRY_BYTES_AT_ONCE: f64 = 2400.0;
/// Number of operators that an urgent report lists regardless of the budget. More than ten rarely act at the same time.
const URGENT_ENTRIES: usize = 8;
/// Smallest interval between two entries about a host that ask for a proof or report a changed loss.
const MIN_INTERVAL: Span = Span::from_millis(400);
/// Change of loss \[of 64 datagrams\] that is reported with priority.
const LOSS_STEP: u8 = 4;

/// Reason why a link report is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occasion {
    /// The period of link reports is over.
    Regular,
    /// Another host needs a link report at once. Only hosts that wait for an entry are listed.
    Urgent,
}

/// Order of the hosts in one link's reports, which list them in turn, and the byte budget of the reports.
#[derive(Clone, Debug)]
pub struct ReportSchedule {
    me: HostId,
    rate: Rate,
    budget: Bucket,
    /// Whether candidates get the remaining place of the next report if the number of places is odd.
    odd: bool,
    /// Whether hosts have to prove their liveness.
    authenticated: bool,
}

impl ReportSchedule {
    /// Returns the state before any report, with a full budget. `me` is this host, `authenticated` says whether the
    /// link has a key, and `entry_bytes` is the length of an entry.
    pub fn new(me: HostId, authenticated: bool, entry_bytes: usize) -> ReportSchedule {
        let size = entry_bytes as f64;
        let rate = Rate { per_s: ENTRY_BYTES_PER_S / size, burst: ENTRY_BYTES_AT_ONCE / size };
        ReportSchedule { me, rate, budget: Bucket::full(Time::ZERO, &rate), odd: false, authenticated }
    }

    /// Returns the schedule with a sustained budget of `bytes_per_s` for entries of `entry_bytes` \[bytes/s\].
    pub fn with_budget(mut self, bytes_per_s: f64, entry_bytes: usize) -> ReportSchedule {
        self.rate.per_s = bytes_per_s / entry_bytes as f64;
        self
    }

    /// Returns the entries of a link report that is sent at `now`, at most `places`: about candidates and about
    /// accepted senders. `uptime` is the time since the start of this process.
    pub fn entries(
        &mut self,
        (now, uptime): (Time, Span),
        places: usize,
        occasion: Occasion,
        candidates: &mut Candidates,
        senders: &mut Senders,
    ) -> Vec<Entry> {
        let waiting = candidates.waiting(now);
        let mut others: Vec<(u8, Time, &mut Sender, HostId)> = Vec::new();
        for ((host, _), sender) in senders.iter_mut() {
            let class = self.class(now, sender);
            let stamped = sender.stamp.is_some_and(|(_, at)| now.since(at) < FRESH);
            if stamped && (occasion == Occasion::Regular || class == 0) {
                others.push((class, sender.listed.unwrap_or(Time::ZERO), sender, host));
            }
        }
        others.sort_by_key(|(class, listed, ..)| (*class, *listed));
        let mut free = if occasion == Occasion::Urgent { URGENT_ENTRIES } else { 0 };
        let mut entries = Vec::new();
        let room = self.budget.left(now, &self.rate).min(places);
        self.odd = !self.odd;
        // Places are shared, so that recordings cannot displace accepted hosts, nor these the candidates.
        let share = (room + usize::from(self.odd)) / 2;
        let mut share = share.max(room.saturating_sub(others.len()));
        for (host, candidate) in waiting {
            if entries.len() >= places {
                break;
            }
            if host.is_operator() && free > 0 {
                free -= 1;
            } else if share > 0 && self.budget.take(now, &self.rate) {
                share -= 1;
            } else {
                continue;
            }
            candidates.echoed(host, candidate.stamp);
            entries.push(self.of_candidate(now, uptime, host, candidate));
        }
        for (_, _, sender, host) in others {
            if entries.len() >= places || !self.budget.take(now, &self.rate) {
                break;
            }
            entries.push(self.of_sender(now, host, sender));
        }
        entries
    }

    fn of_candidate(&self, now: Time, uptime: Span, host: HostId, candidate: Candidate) -> Entry {
        let own_id = host == self.me && !host.is_operator();
        let held = if own_id { uptime } else { now.since(candidate.at) };
        Entry { host, echo: candidate.stamp, held, lost: 0, challenge: !own_id, direct: None }
    }

    fn of_sender(&self, now: Time, host: HostId, sender: &mut Sender) -> Entry {
        let (echo, at) = sender.stamp.expect("one without a stamp is not listed");
        let lost = sender.lost();
        (sender.listed, sender.loss_sent, sender.challenged) = (Some(now), lost, false);
        Entry { host, echo, held: now.since(at), lost, challenge: self.challenges(now, sender), direct: None }
    }

    /// Whether to ask a sender for a liveness proof: after half of the validity of its last one, or if another
    /// incarnation of its host says that it has taken its place.
    pub fn challenges(&self, now: Time, sender: &Sender) -> bool {
        let aging = now.since(sender.proved) > Span::from_nanos(PROOF_VALIDITY.as_nanos() / 2);
        self.authenticated && (aging || sender.has_rival(now))
    }

    /// Whether the loss of a sender differs so much from what was reported of it that the next report is to say so.
    pub fn has_news(sender: &Sender) -> bool {
        let (lost, reported) = (sender.lost(), sender.loss_sent);
        let crosses = |bar: u8| (lost >= bar) != (reported >= bar);
        crosses(LOSS_TO_REPEAT) || crosses(LOSS_TO_REPEAT_TWICE) || lost.abs_diff(reported) >= LOSS_STEP
    }

    fn class(&self, now: Time, sender: &Sender) -> u8 {
        let Some(listed) = sender.listed else { return 0 };
        if sender.challenged {
            return 0;
        }
        if now.since(listed) < MIN_INTERVAL {
            return 3;
        }
        if self.challenges(now, sender) {
            return 1;
        }
        if ReportSchedule::has_news(sender) { 2 } else { 3 }
    }
}
