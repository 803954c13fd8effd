//! Messages in parts that a host receives: one of each robot at a time, until it is whole or its time is over.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Lacking, Settings, numbers};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{Features, Latent, Missing, Part};
use crate::time::{Span, Time};

/// Time without a part of a robot after which its messages are numbered anew.
const FORGET: Span = Span::from_millis(2000);

/// Reason for which a part is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// It has come before, or its message was delivered.
    Duplicate,
    /// It is of an older message.
    Stale,
    /// It contradicts another part of its message.
    Contradicts,
    /// Its sender runs another policy, with this beginning of the digest.
    Policy(u32),
}

/// The messages in parts that a host receives.
#[derive(Clone, Debug)]
pub struct Inbox {
    settings: Settings,
    streams: BTreeMap<RobotId, Stream>,
    due: Option<Time>,
}

/// Messages of one robot.
#[derive(Clone, Debug)]
struct Stream {
    incarnation: u32,
    /// Number of the newest message of which a part has come.
    newest: u16,
    heard: Time,
    present: Option<Assembly>,
    /// Floats of the last message that was delivered.
    last: Option<Arc<[f32]>>,
}

/// Message of which some parts have come.
#[derive(Clone, Debug)]
struct Assembly {
    /// Any of its parts.
    part: Latent,
    floats: Vec<f32>,
    /// Bit for each part: whether it has come.
    here: u128,
    /// Time at which the first part would have come.
    began: Time,
    /// Link by which the parts come, and their sender.
    from: (LinkId, HostId),
    /// For each part, the time from which on it is asked for.
    ask: Vec<Time>,
}

impl Assembly {
    fn part(&self) -> &Part {
        self.part.part.as_ref().expect("an assembly is of parts")
    }

    fn missing(&self) -> u128 {
        let all = u128::MAX >> (128 - u32::from(self.part().of));
        all & !self.here
    }
}

impl Inbox {
    /// Returns an inbox without messages.
    pub fn new(settings: Settings) -> Inbox {
        Inbox { settings, streams: BTreeMap::new(), due: None }
    }

    /// Takes a part at `now` that has come by a link from a host in this incarnation. `jitter` is a random number from
    /// 0 to 1, by which the requests of several receivers do not all leave at once. Appends messages that end with it
    /// to `out`: its own, and the one before, which it replaces. Returns the number of parts of the latter that have
    /// never come.
    pub fn take(
        &mut self,
        now: Time,
        (from, incarnation): ((LinkId, HostId), u32),
        latent: Latent,
        jitter: f64,
        out: &mut Vec<Latent>,
    ) -> Result<u32, Refused> {
        let Some(part) = &latent.part else { return Err(Refused::Contradicts) };
        let Settings { form, floats, policy, .. } = self.settings;
        if (part.policy, usize::from(part.floats), part.encoding) != (policy, floats, form.encoding.code()) {
            return Err(Refused::Policy(part.policy));
        }
        let (robot, message) = (latent.robot, part.message);
        let fresh = || Stream { incarnation, newest: message.wrapping_sub(1), heard: now, present: None, last: None };
        let stream = self.streams.entry(robot).or_insert_with(fresh);
        if stream.incarnation != incarnation || now.since(stream.heard) > FORGET {
            *stream = fresh();
        }
        let ahead = message.wrapping_sub(stream.newest);
        if ahead > u16::MAX / 2 {
            return Err(Refused::Stale);
        }
        let mut lost = 0;
        if ahead > 0 {
            lost = stream.finish(now, form.missing, out);
            (stream.newest, stream.present) = (message, Some(self.settings.begin(now, from, &latent, jitter)));
            stream.present.as_mut().expect("it has just begun").fill(form.missing, stream.last.as_deref());
        }
        stream.heard = now;
        let Some(present) = &mut stream.present else { return Err(Refused::Duplicate) };
        let refused = match present.here & (1 << part.index) {
            _ if !part.is_of(present.part()) => Some(Refused::Contradicts),
            0 => None,
            _ => Some(Refused::Duplicate),
        };
        if refused.is_none() {
            present.here |= 1 << part.index;
            part.write(&mut present.floats);
            if present.missing() == 0 {
                stream.finish(now, form.missing, out);
            }
        }
        self.plan();
        refused.map_or(Ok(lost), Err)
    }

    /// Ends the messages whose time is over at `now`, and appends those that are used without their missing parts to
    /// `out`. Appends the requests that are due to `ask`, each with the link and the host to ask. Returns the number of
    /// parts that have never come.
    pub fn wake(&mut self, now: Time, out: &mut Vec<Latent>, ask: &mut Vec<((LinkId, HostId), Lacking)>) -> u32 {
        let (period, retry, missing) = (self.settings.period, self.settings.retry(), self.settings.form.missing);
        let mut lost = 0;
        for (robot, stream) in &mut self.streams {
            let Some(present) = &mut stream.present else { continue };
            if now >= present.began + period {
                lost += stream.finish(now, missing, out);
                continue;
            }
            let mut parts = 0;
            for index in numbers(present.missing()) {
                let due = &mut present.ask[usize::from(index)];
                if *due <= now {
                    *due = now + retry;
                    parts |= 1 << index;
                }
            }
            if parts != 0 {
                ask.push((present.from, Lacking { robot: *robot, message: stream.newest, parts }));
            }
        }
        self.plan();
        lost
    }

    /// Notes that another host has asked for these parts at `now`, so that they come without a request of this host.
    pub fn asked_by_others(&mut self, now: Time, all: &[Lacking]) {
        all.iter().for_each(|lacking| self.postpone(now, lacking));
        self.plan();
    }

    fn postpone(&mut self, now: Time, lacking: &Lacking) {
        let retry = self.settings.retry();
        let Some(stream) = self.streams.get_mut(&lacking.robot) else { return };
        let present = stream.present.as_mut().filter(|_| stream.newest == lacking.message);
        let Some(present) = present else { return };
        for index in numbers(lacking.parts) {
            if let Some(due) = present.ask.get_mut(usize::from(index)) {
                *due = (*due).max(now + retry);
            }
        }
    }

    /// Returns the time at which to call [`Inbox::wake`]; `None` if no message is incomplete.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    fn plan(&mut self) {
        let present = self.streams.values().filter_map(|stream| stream.present.as_ref());
        self.due = present
            .map(|present| {
                let asks = numbers(present.missing()).map(|index| present.ask[usize::from(index)]);
                asks.fold(present.began + self.settings.period, Time::min)
            })
            .min();
    }
}

impl Settings {
    /// Begins a message with its first part to come, `latent`, at `now`.
    fn begin(&self, now: Time, from: (LinkId, HostId), latent: &Latent, jitter: f64) -> Assembly {
        let part = latent.part.as_ref().expect("it is a part");
        let spacing = self.spacing(part.of);
        let before = spacing.as_nanos() * u64::from(part.index);
        let began = Time::from_nanos(now.as_nanos().saturating_sub(before));
        // A part that has not come when the next two have left is asked for.
        let wait = spacing * 2 + Span::from_secs(self.retry().as_secs() * (0.2 + 0.5 * jitter));
        let ask = (0..u64::from(part.of)).map(|index| began + spacing * index + wait).collect();
        Assembly { part: latent.clone(), floats: vec![0.0; self.floats], here: 0, began, from, ask }
    }
}

impl Assembly {
    /// Sets the floats that count until their part comes.
    fn fill(&mut self, missing: Missing, last: Option<&[f32]>) {
        if let (Missing::Last, Some(last)) = (missing, last) {
            self.floats.copy_from_slice(last);
        }
    }
}

impl Stream {
    /// Ends the present message at `now`, if there is one, and appends it to `out` if it is used, with the sender's
    /// position moved on by its velocity: ages count from arrival, and the first part has left before. Returns the
    /// number of its parts that have never come.
    fn finish(&mut self, now: Time, missing: Missing, out: &mut Vec<Latent>) -> u32 {
        let Some(present) = self.present.take() else { return 0 };
        let lost = present.missing().count_ones();
        let used = match missing {
            Missing::Whole => lost == 0,
            Missing::Last => lost == 0 || self.last.is_some(),
            Missing::Zero => true,
        };
        if used {
            let floats: Arc<[f32]> = present.floats.into();
            self.last = Some(Arc::clone(&floats));
            let mut whole = Latent { features: Features(floats), part: None, ..present.part };
            whole.motion.position += whole.motion.velocity * now.since(present.began).as_secs() as f32;
            out.push(whole);
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{FLOATS, at_ms, parts, settings};
    use super::*;

    const FROM: ((LinkId, HostId), u32) = ((LinkId(0), HostId(1)), 9);

    fn take(inbox: &mut Inbox, ms: u64, part: &Latent) -> (Result<u32, Refused>, Vec<Latent>) {
        let mut out = Vec::new();
        (inbox.take(at_ms(ms), FROM, part.clone(), 0.0, &mut out), out)
    }

    fn wake(inbox: &mut Inbox, ms: u64) -> (u32, Vec<Latent>, Vec<Lacking>) {
        let (mut out, mut ask) = (Vec::new(), Vec::new());
        let lost = inbox.wake(at_ms(ms), &mut out, &mut ask);
        (lost, out, ask.into_iter().map(|(_, lacking)| lacking).collect())
    }

    #[test]
    fn a_message_is_delivered_once_when_its_last_part_has_come_in_any_order() {
        let mut inbox = Inbox::new(settings(Missing::Whole));
        let mut all = parts(65_535, 1.5);
        all.reverse();
        for part in &all[..11] {
            assert_eq!(take(&mut inbox, 1, part), (Ok(0), Vec::new()));
        }
        assert_eq!(take(&mut inbox, 1, &all[3]).0, Err(Refused::Duplicate));
        let (taken, whole) = take(&mut inbox, 2, &all[11]);
        assert!(taken == Ok(0) && *whole[0].features.0 == vec![1.5; FLOATS] && whole[0].part.is_none());
        assert_eq!((take(&mut inbox, 3, &all[11]).0, inbox.due()), (Err(Refused::Duplicate), None));
        assert_eq!(take(&mut inbox, 4, &parts(65_534, 0.0)[0]).0, Err(Refused::Stale));
        assert_eq!(take(&mut inbox, 4, &parts(0, 0.0)[0]).0, Ok(0), "numbers wrap");
    }

    #[test]
    fn missing_parts_are_asked_for_and_their_message_ends_with_its_period() {
        let mut inbox = Inbox::new(settings(Missing::Whole));
        let all = parts(0, 1.0);
        for (ms, index) in [(0, 0), (7, 2), (10, 3), (13, 4)] {
            assert_eq!(take(&mut inbox, ms, &all[index]).0, Ok(0));
        }
        let lacking = |parts| vec![Lacking { robot: RobotId(1), message: 0, parts }];
        assert_eq!(wake(&mut inbox, 13), (0, Vec::new(), lacking(1 << 1)));
        assert_eq!(wake(&mut inbox, 14), (0, Vec::new(), Vec::new()), "once a while");
        inbox.asked_by_others(at_ms(24), &lacking(1 << 1));
        assert_eq!(wake(&mut inbox, 26).2, lacking(1 << 5), "another host has asked for part 1");
        assert_eq!(wake(&mut inbox, 60).2, lacking(0b1111_1110_0010));
        assert_eq!(wake(&mut inbox, 100), (8, Vec::new(), Vec::new()));
        assert_eq!(inbox.due(), None);
        assert_eq!(take(&mut inbox, 101, &all[1]).0, Err(Refused::Duplicate), "its time is over");
    }

    #[test]
    fn a_missing_part_is_that_of_the_message_before_or_zero() {
        for (missing, filled) in [(Missing::Whole, None), (Missing::Last, Some(1.0)), (Missing::Zero, Some(0.0))] {
            let mut inbox = Inbox::new(settings(missing));
            parts(0, 1.0).iter().for_each(|part| drop(take(&mut inbox, 0, part)));
            parts(1, 2.0)[1..].iter().for_each(|part| drop(take(&mut inbox, 100, part)));
            let (taken, out) = take(&mut inbox, 200, &parts(2, 3.0)[0]);
            assert_eq!((taken, out.first().map(|out| out.features.0[0])), (Ok(1), filled), "{missing:?}");
            assert!(out.iter().all(|out| out.features.0[FLOATS - 1] == 2.0));
        }
        let mut inbox = Inbox::new(settings(Missing::Last));
        take(&mut inbox, 0, &parts(0, 1.0)[0]).0.expect("it is the first");
        assert_eq!(wake(&mut inbox, 100).1, [], "there is none before");
    }

    #[test]
    fn what_lies_is_refused() {
        let mut inbox = Inbox::new(settings(Missing::Whole));
        let of = |change: &dyn Fn(&mut Part)| {
            let mut latent = parts(0, 1.0).remove(0);
            change(latent.part.as_mut().expect("a part"));
            latent
        };
        assert_eq!(take(&mut inbox, 0, &of(&|part| part.policy = 6)).0, Err(Refused::Policy(6)));
        assert_eq!(take(&mut inbox, 0, &of(&|part| part.floats = 16_384)).0, Err(Refused::Policy(5)));
        assert_eq!(take(&mut inbox, 0, &of(&|_| {})).0, Ok(0));
        assert_eq!(take(&mut inbox, 0, &of(&|part| (part.of, part.index) = (13, 2))).0, Err(Refused::Contradicts));
        let restarted = ((LinkId(0), HostId(1)), 10);
        let begun = inbox.take(at_ms(1), restarted, parts(0, 2.0).remove(0), 0.0, &mut Vec::new());
        assert_eq!(begun, Ok(0), "a sender that was started again begins anew");
    }
}
