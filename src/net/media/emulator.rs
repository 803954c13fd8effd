//! Delay, loss and planned faults of the frames on one emulated link, as `tc netem` applies them on Linux.
//!
//! Delay is fixed, loss is independent for each receiver, and faults come from a fault plan. If the link has an
//! emulated radio channel (module `radio`), the emulator handles only the frames that the channel has delivered. The
//! code is pure: time and randomness are arguments.

use std::collections::BTreeMap;

use rand::RngExt;

use crate::faults::{LinkFault, LinkFaultKind, ManualLinkFault};
use crate::messages::geometry::Vec2;
use crate::messages::ids::HostId;
use crate::messages::wire::{Kind, Wire};
use crate::net::protocol::codec::{self, Content, Flags, Frame, HEADER_BYTES};
use crate::random::Stream;
use crate::time::{Span, Time};

/// Delay and loss of the frames on an emulated link, for messages of some kinds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Impairment {
    /// One-way delay of every frame of the impaired kinds.
    pub delay: Span,
    /// Probability, 0 to 1, that a receiver loses a frame of the impaired kinds, independently for each receiver.
    pub loss: f64,
    /// Kinds of messages that are impaired; frames of all other kinds pass without delay or loss. An empty list impairs
    /// none.
    pub kinds: Vec<Kind>,
}

/// Emulator of one link: applies delay, loss and planned faults to its frames.
#[derive(Clone, Debug)]
pub struct LinkEmulator {
    impairment: Impairment,
    faults: Vec<LinkFault>,
    manual: ManualLinkFault,
    /// Start time of each episode so far, by index of the episode. Planned faults may give their times from the start
    /// of an episode.
    began: BTreeMap<u32, Time>,
    stream: Stream,
}

impl LinkEmulator {
    /// Returns the emulator of one link. `impairment` gives delay and loss, and `faults` are the faults planned for
    /// this link. All random numbers are drawn from `stream`.
    pub fn new(impairment: Impairment, faults: Vec<LinkFault>, stream: Stream) -> LinkEmulator {
        LinkEmulator { impairment, faults, manual: ManualLinkFault::default(), began: BTreeMap::new(), stream }
    }

    /// Sets the fault that a person has chosen while the program runs: a cut link, or more delay and loss for every
    /// frame. It acts in addition to planned faults and replaces the one set before.
    pub fn set_manual(&mut self, manual: ManualLinkFault) {
        self.manual = manual;
    }

    /// Records that the episode with index `episode` begins at time `now`, for faults that are timed from its start.
    /// Only the first call for an episode counts.
    pub fn begin(&mut self, now: Time, episode: u32) {
        self.began.entry(episode).or_insert(now);
    }

    /// Carries one frame, sent at time `now`, from the host `from` to the host `to`. Each copy that arrives is appended
    /// to `arrivals` with its time of arrival; a lost frame appends none. `kind` is the kind of the frame's message.
    /// Delay, loss and planned faults may be limited to some kinds.
    pub fn carry(
        &mut self,
        now: Time,
        kind: Kind,
        (from, to): (HostId, HostId),
        frame: &Frame,
        arrivals: &mut Vec<(Time, Frame)>,
    ) {
        let Some(at) = self.arrival(now, kind) else { return };
        let first = arrivals.len();
        arrivals.push((at, frame.clone()));
        for fault in self.faults.iter().filter(|fault| fault.hits(now, &self.began, kind, (from, to))) {
            if fault.share < 1.0 && !self.stream.random_bool(fault.share) {
                continue;
            }
            match fault.kind {
                LinkFaultKind::Drop | LinkFaultKind::Partition => arrivals.truncate(first),
                LinkFaultKind::Delay => arrivals[first..].iter_mut().for_each(|(at, _)| *at += fault.by),
                LinkFaultKind::Reorder => {
                    for (at, _) in &mut arrivals[first..] {
                        *at += Span::from_nanos(self.stream.random_range(0..=fault.by.as_nanos()));
                    }
                }
                LinkFaultKind::Duplicate => arrivals.extend_from_within(first..),
                LinkFaultKind::Misplace => {
                    arrivals[first..].iter_mut().for_each(|(_, frame)| *frame = misplaced(frame, fault.off_m));
                }
                LinkFaultKind::Corrupt => {
                    for (_, frame) in &mut arrivals[first..] {
                        *frame = flip_a_bit(frame, &mut self.stream);
                    }
                }
            }
        }
    }

    /// Treats one frame with a message of the kind `kind` as one that no receiver uses: it draws the same random
    /// numbers as `carry`, so that leaving the frame out changes nothing for others. Planned faults must not be on the
    /// link.
    pub fn leave_out(&mut self, now: Time, kind: Kind) {
        self.arrival(now, kind);
    }

    /// Returns whether random numbers are drawn for a frame with a message of this kind.
    pub fn draws(&self, kind: Kind) -> bool {
        self.impairment.loss > 0.0 && self.impairment.kinds.contains(&kind) || self.manual.loss > 0.0
    }

    /// Draws when a frame that is sent at `now` arrives, but for planned faults; `None` if it is lost.
    fn arrival(&mut self, now: Time, kind: Kind) -> Option<Time> {
        let mut at = now;
        if self.impairment.kinds.contains(&kind) {
            if self.impairment.loss > 0.0 && self.stream.random_bool(self.impairment.loss) {
                return None;
            }
            at += self.impairment.delay;
        }
        let ManualLinkFault { cut, delay, loss } = self.manual;
        if cut || loss > 0.0 && self.stream.random_bool(loss.min(1.0)) {
            return None;
        }
        Some(at + delay)
    }
}

/// Returns the frame with the positions in its latents moved by `off_m` \[m\]. A frame with a tag is returned
/// unchanged, and so is a block that is no latent.
fn misplaced(frame: &Frame, off_m: Vec2) -> Frame {
    let Some(header) = codec::peek(frame).ok().filter(|header| !header.flags.has(Flags::TAGGED)) else {
        return Frame::clone(frame);
    };
    let mut bytes = codec::start(&header);
    for (content, body) in codec::blocks(frame).map_while(Result::ok) {
        let message = match content {
            Content::Message(Kind::Latent) => codec::message(Kind::Latent, body).ok(),
            _ => None,
        };
        codec::add(&mut bytes, content, |bytes| match message {
            Some(Wire::Latent(mut latent)) => {
                latent.motion.position += off_m;
                rmp_serde::encode::write(bytes, &latent).expect("plain data is always MessagePack");
            }
            _ => bytes.extend_from_slice(body),
        });
    }
    bytes.into()
}

/// Returns the frame with one random bit of its body flipped. The header stays as it is, since a changed header could
/// turn the frame into a valid one of another sender. A frame without a body is returned unchanged.
fn flip_a_bit(frame: &Frame, stream: &mut Stream) -> Frame {
    let mut bytes = frame.to_vec();
    if bytes.len() > HEADER_BYTES {
        let at = stream.random_range(HEADER_BYTES..bytes.len());
        bytes[at] ^= 1 << stream.random_range(0..8);
    }
    bytes.into()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::ids::RobotId;
    use crate::messages::wire::{Features, Latent, Phase, Round};
    use crate::net::protocol::codec::Header;
    use crate::random::Seed;

    fn carry(emulator: &mut LinkEmulator, kind: Kind) -> Vec<(Time, Frame)> {
        let mut arrivals = Vec::new();
        let frame: Frame = vec![0; 20].into();
        emulator.carry(Time::ZERO, kind, (HostId(0), HostId(1)), &frame, &mut arrivals);
        arrivals
    }

    #[test]
    fn loss_applies_to_the_impaired_kinds_only() {
        let impairment = Impairment { delay: Span::from_millis(20), loss: 0.3, kinds: vec![Kind::Latent] };
        let mut emulator = LinkEmulator::new(impairment, Vec::new(), Seed::of_run(1).stream("link"));
        let arrived = (0..2000).filter(|_| !carry(&mut emulator, Kind::Latent).is_empty()).count();
        assert!((1340..1460).contains(&arrived), "{arrived} of 2000 arrived at 30 % loss");
        assert_eq!(carry(&mut emulator, Kind::Mode)[0].0, Time::ZERO, "other kinds pass at once");
    }

    #[test]
    fn a_manual_fault_acts_on_every_frame_until_it_is_taken_back() {
        let mut emulator = LinkEmulator::new(Impairment::default(), Vec::new(), Seed::of_run(1).stream("link"));
        let delay = Span::from_millis(20);
        emulator.set_manual(ManualLinkFault { delay, ..ManualLinkFault::default() });
        assert_eq!(carry(&mut emulator, Kind::Mode)[0].0, Time::ZERO + delay);
        emulator.set_manual(ManualLinkFault { cut: true, ..ManualLinkFault::default() });
        assert!(carry(&mut emulator, Kind::Mode).is_empty());
        emulator.set_manual(ManualLinkFault { loss: 0.5, ..ManualLinkFault::default() });
        let arrived = (0..2000).filter(|_| !carry(&mut emulator, Kind::Stop).is_empty()).count();
        assert!((900..1100).contains(&arrived), "{arrived} of 2000 arrived at 50 % loss");
        emulator.set_manual(ManualLinkFault::default());
        assert_eq!(carry(&mut emulator, Kind::Mode)[0].0, Time::ZERO);
    }

    #[test]
    fn latents_of_the_named_hosts_alone_are_misplaced_and_stay_valid() {
        let hosts = vec![HostId(0)];
        let fault =
            LinkFault { kind: LinkFaultKind::Misplace, hosts, off_m: Vec2::new(2.0, -1.0), ..LinkFault::always("any") };
        let mut emulator = LinkEmulator::new(Impairment::default(), vec![fault], Seed::of_run(1).stream("link"));
        let motion = Motion { position: Vec2::new(0.5, 0.5), velocity: Vec2::x() };
        let (robot, round, phase) = (RobotId(0), Round::default(), Phase::Running);
        let latent = Latent { robot, round, phase, motion, features: Features(Arc::new([1.0])), part: None };
        let header = Header { flags: Flags(0), team: 1, sender: HostId(0), incarnation: 2, sequence: 3 };
        let frame = codec::encode(&header, &Wire::Latent(latent.clone())).unwrap();
        let mut said = |from: u16| {
            let mut arrivals = Vec::new();
            emulator.carry(Time::ZERO, Kind::Latent, (HostId(from), HostId(2)), &frame, &mut arrivals);
            codec::decode(&arrivals[0].1).unwrap()
        };
        let moved = Motion { position: Vec2::new(2.5, -0.5), ..motion };
        assert_eq!(said(0), (header, Wire::Latent(Latent { motion: moved, ..latent.clone() })));
        assert_eq!(said(1), (header, Wire::Latent(latent)));
    }

    #[test]
    fn a_planned_fault_acts_in_its_window_only() {
        let fault = |kind| LinkFault { kind, by: Span::from_millis(5), ..LinkFault::always("any") };
        let emulator =
            |kind| LinkEmulator::new(Impairment::default(), vec![fault(kind)], Seed::of_run(1).stream("link"));
        assert!(carry(&mut emulator(LinkFaultKind::Drop), Kind::Latent).is_empty());
        assert_eq!(carry(&mut emulator(LinkFaultKind::Duplicate), Kind::Latent).len(), 2);
        assert_eq!(carry(&mut emulator(LinkFaultKind::Delay), Kind::Latent)[0].0, Time::ZERO + Span::from_millis(5));
        let corrupted = carry(&mut emulator(LinkFaultKind::Corrupt), Kind::Latent);
        assert_eq!(corrupted[0].1.iter().map(|byte| byte.count_ones()).sum::<u32>(), 1);
        let mut late = LinkEmulator::new(
            Impairment::default(),
            vec![LinkFault { from: Time::ZERO + Span::from_millis(1), ..fault(LinkFaultKind::Drop) }],
            Seed::of_run(1).stream("link"),
        );
        assert_eq!(carry(&mut late, Kind::Latent).len(), 1);
    }
}
