//! Choice of the hosts in the next report: reports have a budget of bytes, so they take turns. Decides; sends nothing.
//!
//! First candidates, which wait for an echo to prove themselves; then hosts that asked this one for proof; then those
//! whose proof is getting old, to ask them; then those of which more or less is lost than was told; then the others,
//! the one that was listed longest ago first.

use super::bucket::{Bucket, Rate};
use super::candidates::{Candidate, Candidates};
use super::limits::{FRESH, LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE, PROOF_HOLDS};
use super::report::Entry;
use super::sender::Sender;
use super::senders::Senders;
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Budget of the entries of reports in the long run \[bytes/s\]: with headers, tags and heartbeats a host stays
/// below 1.5 kB/s of soft state.
const ENTRY_BYTES_PER_S: f64 = 900.0;
/// Budget of the entries at once \[bytes\]: a team of 200 joins without waiting for the long run.
const ENTRY_BYTES_AT_ONCE: f64 = 2400.0;
/// Operators that an urgent report lists whatever the budget: more than ten of them act at once hardly ever.
const URGENT_ENTRIES: usize = 8;
/// After half of its time a proof is asked for, as often as this at most; a loss is told again no sooner.
const AGAIN: Span = Span::from_millis(400);
/// A change of loss that is worth telling before its turn, of 64.
const LOSS_STEP: u8 = 4;

/// Why a report leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occasion {
    /// It was time.
    Regular,
    /// Another host must hear from this one at once: it lists those that wait and no others.
    Urgent,
}

/// The turns and the budget of one link's reports.
#[derive(Clone, Debug)]
pub struct Telling {
    me: HostId,
    rate: Rate,
    budget: Bucket,
    /// Whether candidates have the odd place of this report.
    odd: bool,
    /// Whether hosts have to prove that they are alive.
    guarded: bool,
}

impl Telling {
    /// A full budget for entries of so many bytes.
    pub fn new(me: HostId, guarded: bool, entry_bytes: usize) -> Telling {
        let size = entry_bytes as f64;
        let rate = Rate { per_s: ENTRY_BYTES_PER_S / size, burst: ENTRY_BYTES_AT_ONCE / size };
        Telling { me, rate, budget: Bucket::full(Time::ZERO, &rate), odd: false, guarded }
    }

    /// The entries of a report that leaves now, at most `places`. `uptime` is how long this process has run.
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
        for (&(host, _), sender) in senders.iter_mut() {
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
        // Recordings must not keep those who are believed from being listed, nor the other way round.
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
        let rival = host == self.me && !host.is_operator();
        let held = if rival { uptime } else { now.since(candidate.at) };
        Entry { host, echo: candidate.stamp, held, lost: 0, asks: !rival, direct: None }
    }

    fn of_sender(&self, now: Time, host: HostId, sender: &mut Sender) -> Entry {
        let (echo, at) = sender.stamp.expect("one without a stamp is not listed");
        let lost = sender.lost();
        (sender.listed, sender.told, sender.wants) = (Some(now), lost, false);
        Entry { host, echo, held: now.since(at), lost, asks: self.asks(now, sender), direct: None }
    }

    /// Whether a sender is asked for proof.
    fn asks(&self, now: Time, sender: &Sender) -> bool {
        self.guarded && now.since(sender.proved) > Span::from_nanos(PROOF_HOLDS.as_nanos() / 2)
    }

    fn class(&self, now: Time, sender: &Sender) -> u8 {
        let Some(listed) = sender.listed else { return 0 };
        if sender.wants {
            return 0;
        }
        if now.since(listed) < AGAIN {
            return 3;
        }
        if self.asks(now, sender) {
            return 1;
        }
        let (lost, told) = (sender.lost(), sender.told);
        let crosses = |bar: u8| (lost >= bar) != (told >= bar);
        let changed = crosses(LOSS_TO_REPEAT) || crosses(LOSS_TO_REPEAT_TWICE) || lost.abs_diff(told) >= LOSS_STEP;
        if changed { 2 } else { 3 }
    }
}
