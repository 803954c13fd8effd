//! Station of a network study that uses the project's link layer: best effort, repeat or nack.

use super::case::{Addressing, ReliabilityMode};
use super::endpoint::{Output, StationProtocol};
use super::traffic;
use murmurate::messages::ids::{HostId, LinkId};
use murmurate::messages::wire::{Kind, Wire};
use murmurate::net::protocol::codec::{self, Frame};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::link::{Identity, LinkState};
use murmurate::net::protocol::reliability::{Reliabilities, Reliability, Setup};
use murmurate::net::protocol::router::Audience;
use murmurate::random::{Seed, Stream};
use murmurate::time::Time;

/// Arbitrary key; the length of datagrams does not depend on it.
const KEY: [u8; 32] = *b"the key of the network study....";
const LINK: LinkId = LinkId(0);

/// Station of a network study that uses the project's link layer: best effort, repeat or nack.
pub struct Linked {
    station: u16,
    features: usize,
    state: LinkState,
    stream: Stream,
    leaving: Vec<(Audience, Frame)>,
}

/// Returns the configuration of the link layer for the stations of a network study. Panics if `reliability` is a mode
/// of RTPS, which the link layer does not have.
pub fn setup(addressing: Addressing, reliability: ReliabilityMode) -> Setup {
    let reliability = match reliability {
        ReliabilityMode::BestEffort => Reliability::BestEffort,
        ReliabilityMode::Repeat => Reliability::Repeat,
        ReliabilityMode::Nack => Reliability::Nack,
        ReliabilityMode::Ack | ReliabilityMode::AckOff => unreachable!("RTPS has stations of its own"),
    };
    let reliabilities = Reliabilities::from([(Kind::Latent, reliability)]);
    match addressing {
        Addressing::Unicast => Setup::unicast(reliabilities),
        Addressing::Multicast => Setup::multicast(reliabilities),
    }
}

impl Linked {
    /// Returns the station with the index `station`. `setup` configures its link layer; its messages have `features`
    /// features, and its datagrams a keyed tag.
    pub fn new(station: u16, setup: Setup, features: usize, seed: &Seed) -> Linked {
        let mut stream = seed.stream(&format!("link/{station}"));
        let me = Identity { host: HostId(station), team: 1, incarnation: 1 };
        let state = LinkState::new(me, LINK, Some(Key::new(KEY)), setup, &mut stream);
        Linked { station, features, state, stream, leaving: Vec::new() }
    }

    fn leave(&mut self, out: &mut Vec<Output<Frame>>) {
        for (audience, packet) in self.leaving.drain(..) {
            let to = match audience {
                Audience::All => None,
                Audience::Host(host) => Some(host.0),
            };
            out.push(Output::Send { to, bytes: packet.len(), packet });
        }
    }
}

impl StationProtocol for Linked {
    type Packet = Frame;

    fn publish(&mut self, now: Time, sequence: u32, out: &mut Vec<Output<Frame>>) {
        let latent = traffic::message(self.station, 0, sequence, now.since(Time::ZERO), self.features);
        self.state
            .send(now, Audience::All, &Wire::Latent(latent), &mut self.leaving)
            .expect("a checked sweep has messages that fit");
        self.leave(out);
    }

    fn receive(&mut self, now: Time, frame: &Frame, out: &mut Vec<Output<Frame>>) {
        let admitted = self.state.admit(now, frame, &mut self.stream, &mut self.leaving);
        let mut heard = Vec::new();
        if let Some((header, plain)) = admitted {
            for (kind, body, signature) in codec::messages(&plain) {
                let Ok(message) = codec::message(kind, body) else { continue };
                if self.state.accept(now, &header, &message, (body, signature))
                    && let Wire::Latent(latent) = message
                {
                    heard.push(Output::Deliver { from: latent.robot.0, sequence: latent.round.episode });
                }
            }
        }
        self.leave(out);
        out.append(&mut heard);
    }

    fn wake_at(&self) -> Option<Time> {
        self.state.due()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Output<Frame>>) {
        self.state.wake(now, &mut self.stream, &mut self.leaving);
        self.leave(out);
    }
}
