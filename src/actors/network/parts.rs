//! The part of a Network that sends and receives messages in parts, which are too large for one datagram.

use rand::RngExt;

use super::{Network, Out, transmit};
use crate::messages::ids::{LinkId, RobotId};
use crate::messages::wire::{Kind, Latent, MAX_PART_BYTES, Phase, Wire};
use crate::net::protocol::codec::Header;
use crate::net::protocol::parts::{Inbox, Lacking, Outbox, Refused, Settings, split};
use crate::time::Time;

/// Messages in parts of one host.
#[derive(Debug)]
pub(super) struct Parts {
    settings: Settings,
    outbox: Outbox,
    inbox: Inbox,
}

impl Parts {
    pub(super) fn new(settings: Settings) -> Parts {
        Parts { settings, outbox: Outbox::default(), inbox: Inbox::new(settings) }
    }

    pub(super) fn due(&self) -> Option<Time> {
        [self.outbox.due(), self.inbox.due()].into_iter().flatten().min()
    }
}

impl Network {
    /// Returns whether a message is one that this host sends in parts: that of the policy under test, and not that by
    /// which robots drive to their starts.
    pub(super) fn is_in_parts(&self, latent: &Latent) -> bool {
        let floats = latent.features.0.len();
        let is_of_the_test = latent.phase == Phase::Running && latent.part.is_none();
        is_of_the_test && self.parts.as_ref().is_some_and(|parts| parts.settings.floats == floats)
    }

    /// Publishes a message in parts: the first leaves at once. Robots of this host hear the whole message. If it leaves
    /// on no link, the Recorder gets all parts at once: there is no channel to keep free.
    pub(super) fn publish_in_parts(&mut self, now: Time, latent: Latent, out: &mut Vec<Out>) {
        let route = self.router.route(Kind::Latent, latent.robot);
        let room = route.leaves.and_then(|(link, _)| self.link(link)).map(|state| state.room());
        let parts = self.parts.as_mut().expect("a message in parts is published where there are settings for it");
        let settings = parts.settings;
        let number = (parts.outbox.number(latent.robot), settings.policy);
        let most = room.map_or(MAX_PART_BYTES, Settings::most);
        let all = split(&latent, settings.form.encoding, number, most);
        parts.outbox.put(now, all, &settings);
        self.send_parts(now, if room.is_some() { now } else { Time::MAX }, out);
        if route.local {
            out.push(Out::Deliver(Wire::Latent(latent)));
        }
    }

    /// Sends the parts that are due by the time `until`.
    fn send_parts(&mut self, now: Time, until: Time, out: &mut Vec<Out>) {
        while let Some((part, again)) = self.parts.as_mut().and_then(|parts| parts.outbox.next(until)) {
            let route = self.router.route(Kind::Latent, part.robot);
            let sent = self.send(now, route, &Wire::Latent(part), out);
            if sent
                && again
                && let Some(state) = route.leaves.and_then(|(link, _)| self.link(link))
            {
                state.counts().sent_again();
            }
        }
    }

    /// Takes a part of a message that has come by `link` in a datagram with this header.
    pub(super) fn take_part(&mut self, now: Time, (link, header): (LinkId, &Header), part: Latent, out: &mut Vec<Out>) {
        let (robot, from) = (part.robot, ((link, header.sender), header.incarnation));
        let jitter = self.stream.random_range(0.0..1.0);
        let mut whole = Vec::new();
        let Some(parts) = &mut self.parts else {
            return self.count_part(link, robot, Err(Refused::Policy(part.part.map_or(0, |part| part.policy))));
        };
        let taken = parts.inbox.take(now, from, part, jitter, &mut whole);
        self.count_part(link, robot, taken);
        out.extend(whole.into_iter().map(Wire::Latent).map(Out::Deliver));
    }

    fn count_part(&mut self, link: LinkId, robot: RobotId, taken: Result<u32, Refused>) {
        let counts = self.links[usize::from(link.0)].as_mut().expect("a part has come by the link").counts();
        match taken {
            Ok(lost) => {
                counts.accepted += 1;
                counts.incomplete += u64::from(lost);
            }
            Err(Refused::Duplicate) => counts.duplicate += 1,
            Err(Refused::Stale) => counts.stale += 1,
            Err(Refused::Contradicts) => counts.mixed += 1,
            Err(Refused::Policy(theirs)) => {
                counts.mixed += 1;
                self.report_mixed(robot, theirs);
            }
        }
    }

    #[cold]
    fn report_mixed(&mut self, robot: RobotId, theirs: u32) {
        if std::mem::replace(&mut self.mixed_reported, true) {
            return;
        }
        let ours = match &self.parts {
            Some(parts) => format!("the policy {:08x}", parts.settings.policy),
            None => "one whose messages fit into a datagram".to_owned(),
        };
        tracing::error!(
            "{robot} runs the policy {theirs:08x}, and this host {ours}: its messages are not used. Give all hosts the \
             same policy file"
        );
    }

    /// Handles what the sender of a datagram that has come by `link` lacks of messages in parts.
    pub(super) fn note_lacking(&mut self, now: Time, link: LinkId) {
        let Some(state) = self.links[usize::from(link.0)].as_ref() else { return };
        let Some(parts) = &mut self.parts else { return };
        parts.outbox.asked(now, state.lacking());
        // Elsewhere the sender may not have heard the request.
        if self.shared[usize::from(link.0)] {
            parts.inbox.asked_by_others(now, state.lacking());
        }
    }

    /// Sends what is due of messages in parts: parts and requests for parts. Delivers those whose time is over.
    pub(super) fn wake_parts(&mut self, now: Time, out: &mut Vec<Out>) {
        self.send_parts(now, now, out);
        let Some(parts) = &mut self.parts else { return };
        if parts.inbox.due().is_none_or(|due| due > now) {
            return;
        }
        let (mut ended, mut ask) = (Vec::new(), Vec::new());
        let lost = parts.inbox.wake(now, &mut ended, &mut ask);
        self.local_counts.incomplete += u64::from(lost);
        out.extend(ended.into_iter().map(Wire::Latent).map(Out::Deliver));
        // One request for each host that is asked.
        ask.sort_by_key(|(from, _)| *from);
        for asked in ask.chunk_by(|(one, _), (other, _)| one == other) {
            let (link, host) = asked[0].0;
            let lacking: Vec<Lacking> = asked.iter().map(|(_, lacking)| *lacking).collect();
            let at = usize::from(link.0);
            let Some(state) = self.links[at].as_mut().filter(|state| state.repairs_parts()) else { continue };
            state.ask_for_parts(host, &lacking, &mut self.outgoing);
            self.due[at] = state.due();
            transmit(link, &mut self.outgoing, out);
        }
    }
}
