//! Which messages of an accepted sender are taken: those that are newer than others of their stream, and, where members
//! have keys of their own, have the signature that they need. `signing` checks signatures.

use super::codec::{Flags, Header};
use super::incoming::Incoming;
use super::key::Key;
use super::link::LinkState;
use super::parts::is_part;
use super::retransmit::StreamId;
use super::signatures::{Signatures, Signed};
use super::signing;
use crate::messages::ids::LinkId;
use crate::messages::wire::Wire;
use crate::time::Time;

/// Signature check that a message needs before it is believed.
enum Claim {
    /// Nothing: it needs no signature.
    Plain,
    /// It lacks the signature that it needs, or is not for this run of this host.
    Refused,
    /// This signature.
    Signed(Signed),
}

/// Returns what the process with the header `me` has to check of a message with this body, and the signature after it,
/// from the process with the header `sender` on a link. A stop in the name of another member is not believed, and no
/// order without a signature in the name of an operator.
fn claim(
    by: &Signatures,
    (me, sender, link): (&Header, &Header, LinkId),
    message: &Wire,
    (body, signature): (&[u8], Option<&[u8]>),
) -> Claim {
    match message {
        Wire::Stop(stop) if stop.by != sender.sender || stop.releases() && stop.by.is_operator() => Claim::Refused,
        Wire::Release(release) => {
            // An operator only shows it.
            let is_for_me = me.sender.is_operator() || release.names(me.sender, me.incarnation);
            if is_for_me && release.by.is_operator() {
                Claim::Signed(Signed::release(me.team, release))
            } else {
                Claim::Refused
            }
        }
        _ if !message.kind().is_signed() || by.are_trusted() => Claim::Plain,
        _ => signature
            .and_then(|block| signing::claimed((sender, link), message.kind(), body, block))
            .map_or(Claim::Refused, Claim::Signed),
    }
}

impl Incoming {
    /// Returns whether a message about `robot` is newer than all others of its stream (kind and robot).
    pub(super) fn is_newest(&self, header: &Header, (kind, robot): StreamId) -> bool {
        let Some(sender) = self.senders.get((header.sender, header.incarnation)) else { return false };
        let newest = sender.spaces[usize::from(header.flags.has(Flags::DIRECT))].newest.get(&(kind, robot));
        newest.is_none_or(|newest| (1..=u32::MAX / 2).contains(&header.sequence.wrapping_sub(*newest)))
    }

    fn checks(&mut self, now: Time, header: &Header, stream: StreamId, (signed, by): (&Signed, &Signatures)) -> bool {
        let sender = self.senders.get_mut((header.sender, header.incarnation));
        sender.is_some_and(|sender| sender.checked.check(now, stream, signed, by))
    }
}

impl LinkState {
    /// Returns whether a decoded message is newer than all others of its stream (kind and robot) and believed, and
    /// records it if so. A new emergency stop of its sender counts as newer. `body` is that of the message, and the
    /// signature that which follows it.
    pub fn accept(&mut self, now: Time, header: &Header, message: &Wire, body: (&[u8], Option<&[u8]>)) -> bool {
        let (kind, robot) = (message.kind(), message.robot());
        if is_part(message) {
            // Their own numbers order them; that a part is new is known to those that join them.
            return self.incoming.senders.get((header.sender, header.incarnation)).is_some();
        }
        let stop = if let Wire::Stop(stop) = message { Some(*stop) } else { None };
        let stop = stop.filter(|stop| self.incoming.is_new_stop(header, *stop));
        // A signature is looked at in what is newer alone. Without signatures nothing has to be looked at first.
        let signs = self.key.as_ref().and_then(Key::signatures).is_some();
        let looks = signs && (stop.is_some() || self.incoming.is_newest(header, (kind, robot)));
        if looks && !self.believes(now, header, message, body) {
            return false;
        }
        if let Some(stop) = stop {
            self.incoming.note_stop(header, stop);
        }
        self.incoming.accept(header, kind, robot, &mut self.counts) || stop.is_some()
    }

    /// Returns whether a message of an accepted sender is believed: always in a team with one key, and with the
    /// signature that it needs where members have keys of their own. Counts one that is not.
    pub(super) fn believes(
        &mut self,
        now: Time,
        header: &Header,
        message: &Wire,
        body: (&[u8], Option<&[u8]>),
    ) -> bool {
        let Some(by) = self.key.as_ref().and_then(Key::signatures) else { return true };
        let me = Header { sender: self.me.host, incarnation: self.me.incarnation, ..*header };
        let believed = match claim(by, (&me, header, self.id), message, body) {
            Claim::Plain => true,
            Claim::Refused => false,
            Claim::Signed(signed) => {
                let stream = (message.kind(), message.robot());
                self.incoming.checks(now, header, stream, (&signed, by))
            }
        };
        self.counts.unsigned += u64::from(!believed);
        believed
    }
}

#[cfg(test)]
mod tests {
    use super::super::codec::{self, BLOCK_BYTES, Flags, Frame, HEADER_BYTES, MAX_MEMBERS};
    use super::super::member::public;
    use super::super::signing::{Checked, Signing};
    use super::super::tags::Bytes;
    use super::*;
    use crate::messages::geometry::{Task, Vec2};
    use crate::messages::ids::{HostId, RobotId};
    use crate::messages::latch::Latch;
    use crate::messages::wire::{MAX_SIGNED_BLOCK, Mode, Phase, Release, Round, Stop};
    use crate::time::Span;

    const SERVER: HostId = HostId(4);
    const LINK: LinkId = LinkId(2);
    const OPERATOR: HostId = HostId::operator(1);
    /// Length of a signature with edition and the header of its block \[bytes\].
    const SIGNED_BYTES: usize = BLOCK_BYTES + 4 + 64;

    fn secret(member: HostId) -> Bytes {
        *blake3::hash(&member.0.to_le_bytes()).as_bytes()
    }

    fn of(member: HostId) -> Signatures {
        let members = (0..5).map(HostId).chain([OPERATOR]).map(|host| (host, public(&secret(host)))).collect();
        Signatures::new(Some(secret(member)), &members).expect("they are keys")
    }

    fn header(sender: u16, incarnation: u32) -> Header {
        Header { flags: Flags(0), team: 7, sender: HostId(sender), incarnation, sequence: 1 }
    }

    fn mode(episode: u32, robots: usize) -> Wire {
        let task = Task { start: Vec2::new(0.5, 1.0), goal: Vec2::new(-0.5, 2.0) };
        let (round, latch) = (Round { term: 1 << 20, episode }, Latch::engaged(1 << 40));
        let (phase, first) = (Phase::Running, RobotId(1000));
        Wire::Mode(Mode { round, repeat: u32::MAX, phase, first, tasks: vec![task; robots].into(), latch })
    }

    fn stop(number: u64) -> Wire {
        Wire::Stop(Stop { by: SERVER, latch: Latch::engaged(number) })
    }

    fn signed(signing: &mut Signing, me: &Header, message: &Wire) -> Frame {
        let encoded = codec::encode(me, message).expect("it is sound");
        let stream = (message.kind(), message.robot());
        signing.sign(&of(me.sender), (me, LINK), stream, &encoded).expect("it has a key")
    }

    /// Whether a host that has checked `checked` believes the only message of a datagram.
    fn believed(checked: &mut Checked, ms: u64, datagram: &[u8]) -> bool {
        let header = codec::peek(datagram).expect("it is one");
        let (kind, body, signature) = codec::messages(datagram).next().expect("it has a message");
        let message = codec::message(kind, body).expect("it is sound");
        let now = Time::ZERO + Span::from_millis(ms);
        let by = of(HostId(0));
        match claim(&by, (&self::header(0, 1), &header, LINK), &message, (body, signature)) {
            Claim::Signed(signed) => checked.check(now, (kind, message.robot()), &signed, &by),
            Claim::Plain => true,
            Claim::Refused => false,
        }
    }

    fn release(by: HostId, latch: Latch, signer: HostId) -> Wire {
        of(signer).signed(7, Stop { by, latch }, [(HostId(0), 5), (HostId(1), 6)].into_iter())
    }

    /// Whether a process believes a release that any member has sent it.
    fn takes(me: &Header, message: &Wire) -> bool {
        let by = of(HostId(0));
        match claim(&by, (me, &header(3, 3), LINK), message, (&[], None)) {
            Claim::Plain => true,
            Claim::Refused => false,
            Claim::Signed(signed) => by.verify(&signed),
        }
    }

    #[test]
    fn a_release_is_believed_of_its_operator_and_for_the_runs_of_the_hosts_that_it_names() {
        let signed = release(OPERATOR, Latch::held(4), OPERATOR);
        assert!(takes(&header(0, 5), &signed) && takes(&header(1, 6), &signed));
        assert!(takes(&header(OPERATOR.0, 9), &signed), "operators show it");
        assert!(!takes(&header(0, 6), &signed), "after a restart");
        assert!(!takes(&header(2, 5), &signed), "of a host that it does not name");
        assert!(!takes(&Header { team: 8, ..header(0, 5) }, &signed), "of another team");
        assert!(!takes(&header(0, 5), &release(OPERATOR, Latch::held(4), HostId(3))), "with another key");
        assert!(
            !takes(&header(0, 5), &release(HostId::operator(2), Latch::held(4), OPERATOR)),
            "of an unknown operator"
        );
        let Wire::Release(signed) = signed else { panic!("an operator signs") };
        let altered = [
            Release { latch: Latch::held(5), ..signed.clone() },
            Release { latch: Latch::clear(4), ..signed.clone() },
            Release { hosts: vec![(HostId(0), 5)], ..signed.clone() },
            Release { hosts: vec![(HostId(0), 5), (HostId(1), 7)], ..signed.clone() },
            Release { by: HostId(0), ..signed },
        ];
        for altered in altered {
            assert!(!takes(&header(0, 5), &Wire::Release(altered.clone())), "{altered:?}");
        }
        for latch in [Latch::held(4), Latch::clear(5)] {
            let order = Wire::Stop(Stop { by: OPERATOR, latch });
            assert!(!takes(&header(0, 5), &order), "an order without a signature");
        }
    }

    #[test]
    fn a_stop_and_an_instruction_are_believed_of_their_signer_as_they_are_or_not_at_all() {
        let me = header(4, 9);
        for message in [mode(3, 5), stop(1)] {
            let sound = signed(&mut Signing::default(), &me, &message);
            let fresh = || Checked::new(Time::ZERO);
            assert!(believed(&mut fresh(), 0, &sound));
            let in_name_of = |header: &Header| {
                let mut other = codec::start(header);
                other.extend_from_slice(&sound[HEADER_BYTES..]);
                other
            };
            let others = [header(3, 9), header(4, 8), header(7, 9), Header { team: 8, ..me }];
            assert!(others.iter().all(|header| !believed(&mut fresh(), 0, &in_name_of(header))));
            assert!(believed(&mut fresh(), 0, &in_name_of(&Header { sequence: 77, ..me })), "it is repeated");
            let bare = codec::encode(&me, &message).expect("it is sound");
            assert!(!believed(&mut fresh(), 0, &bare), "without a signature");
            for bit in 0..8 * (SIGNED_BYTES - BLOCK_BYTES) {
                let mut turned = sound.to_vec();
                let at = turned.len() - 1 - bit / 8;
                turned[at] ^= 1 << (bit % 8);
                assert!(!believed(&mut fresh(), 0, &turned), "bit {bit} from the end");
            }
        }
        // The signature of one message after another one.
        let [first, second] = [mode(3, 5), mode(4, 5)].map(|mode| signed(&mut Signing::default(), &me, &mode));
        let mut mixed = first[..first.len() - SIGNED_BYTES].to_vec();
        mixed.extend_from_slice(&second[second.len() - SIGNED_BYTES..]);
        assert!(!believed(&mut Checked::new(Time::ZERO), 0, &mixed));
    }

    #[test]
    fn what_is_repeated_has_the_same_signature_and_an_older_instruction_is_not_believed_again_but_a_stop_is() {
        let (me, mut signing, mut checked) = (header(4, 9), Signing::default(), Checked::new(Time::ZERO));
        let first = signed(&mut signing, &me, &mode(3, 5));
        assert_eq!(signed(&mut signing, &me, &mode(3, 5)), first);
        let second = signed(&mut signing, &me, &mode(4, 5));
        let back = signed(&mut signing, &me, &mode(3, 5));
        assert_ne!(back, first, "it is said anew");
        assert!([&first, &second, &back].iter().all(|frame| believed(&mut checked, 0, frame)));
        assert!(!believed(&mut checked, 0, &first) && !believed(&mut checked, 0, &second));
        let [one, two] = [stop(1), stop(3)].map(|stop| signed(&mut signing, &me, &stop));
        assert!([&two, &one, &two].iter().all(|frame| believed(&mut checked, 0, frame)));
    }

    #[test]
    fn a_sender_that_signs_without_pause_is_checked_at_a_rate_and_what_was_checked_stays_believed() {
        let (me, mut signing, mut checked) = (header(4, 9), Signing::default(), Checked::new(Time::ZERO));
        let first = signed(&mut signing, &me, &stop(1));
        assert!(believed(&mut checked, 0, &first));
        let flood = (2..=1000u64).filter(|at| believed(&mut checked, *at, &signed(&mut signing, &me, &stop(*at))));
        let checks = flood.count();
        assert!((190..=200).contains(&checks), "{checks} in a second");
        let last = signed(&mut signing, &me, &stop(2000));
        assert!(believed(&mut checked, 2000, &last) && believed(&mut checked, 2000, &last));
    }

    #[test]
    fn the_largest_instruction_fits_with_its_signature_into_a_confidential_datagram_of_the_largest_team() {
        let pairs = (0..MAX_MEMBERS as u16).map(|host| (HostId(host), [host as u8; 32])).collect();
        let room = Key::of_member([1; 32], pairs).confidential().room();
        let largest = signed(&mut Signing::default(), &header(4, u32::MAX), &mode(u32::MAX, MAX_SIGNED_BLOCK));
        assert!(largest.len() <= room, "{} of {room}", largest.len());
    }
}
