//! Network: the one way out of a host and into it. It decides for every wire message whether it has takers
//! here, which link it leaves on, or both.
//!
//! Each published message is encoded once; the same bytes go to the links and to the Recorder. A frame that
//! arrives is checked, decoded and handed in, or counted and dropped.

use super::Core;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::Wire;
use crate::net::codec::{self, Frame};
use crate::net::link::{LinkCounts, LinkState};
use crate::net::router::{Audience, Router};
use crate::time::{Span, Time};

/// What a Network accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// An actor of this host has something to say.
    Publish(Wire),
    /// A frame has arrived.
    Frame(LinkId, Frame),
}

/// What a Network says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To those on this host who take it.
    Deliver(Wire),
    /// To a link's transport.
    Transmit(LinkId, Audience, Frame),
    /// To the Recorder: everything that was published.
    Tap(Frame),
    /// To the Recorder: what has happened on all links together.
    Counts(LinkCounts),
}

/// How often a Network tells its counts.
pub const COUNTS_PERIOD: Span = Span::from_millis(1000);

/// One host's network.
#[derive(Debug)]
pub struct Network {
    router: Router,
    links: Vec<LinkState>,
    /// Counts the frames that are published but leave on no link.
    indoors: LinkState,
    next_counts: Time,
}

impl Network {
    /// A network of `links` links in its `epoch`th incarnation.
    pub fn new(host: HostId, team: u16, epoch: u32, links: usize, router: Router) -> Network {
        let link = LinkState::new(host, team, epoch);
        Network { router, links: vec![link.clone(); links], indoors: link, next_counts: Time::ZERO }
    }

    fn publish(&mut self, message: Wire, out: &mut Vec<Out>) {
        let route = self.router.route(message.kind(), message.robot());
        let link = match route.leaves {
            Some((link, _)) => &mut self.links[usize::from(link.0)],
            None => &mut self.indoors,
        };
        match codec::encode(&link.stamp(message.kind()), &message) {
            Ok(frame) => {
                if let Some((link, audience)) = route.leaves {
                    out.push(Out::Transmit(link, audience, frame.clone()));
                }
                out.push(Out::Tap(frame));
            }
            Err(error) => {
                if link.unfit() {
                    tracing::error!(robot = message.robot().0, "not sent: {error}; what follows is only counted");
                }
                return;
            }
        }
        if route.local {
            out.push(Out::Deliver(message));
        }
    }

    fn receive(&mut self, link: LinkId, frame: &[u8], out: &mut Vec<Out>) {
        let Some(state) = self.links.get_mut(usize::from(link.0)) else { return };
        match codec::peek(frame) {
            Ok(header) if !state.admit(&header) => return,
            Ok(_) => {}
            Err(error) => return state.refuse(&error),
        }
        match codec::decode(frame) {
            Ok((_, message)) if !self.router.route(message.kind(), message.robot()).local => state.misrouted(),
            Ok((header, message)) => {
                if state.accept(&header, message.robot()) {
                    out.push(Out::Deliver(message));
                }
            }
            Err(error) => state.refuse(&error),
        }
    }
}

impl Core for Network {
    type In = In;
    type Out = Out;

    fn handle(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Publish(message) => self.publish(message, out),
            In::Frame(link, frame) => self.receive(link, &frame, out),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next_counts)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        out.push(Out::Counts(self.links.iter().chain([&self.indoors]).map(LinkState::counts).sum()));
        self.next_counts = now.next_on_grid(Span::ZERO, COUNTS_PERIOD);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::ids::RobotId;
    use crate::messages::wire::{Kind, Reading};
    use crate::net::router::Route;

    const LINK: LinkId = LinkId(0);

    /// Robot 0 lives here, robot 1 elsewhere.
    fn network(host: u16, team: u16) -> Network {
        let router = Router::new(2, |kind, robot| Route {
            local: kind == Kind::Reading && robot == RobotId(0),
            leaves: (robot == RobotId(1)).then_some((LINK, Audience::Host(HostId(9)))),
        });
        Network::new(HostId(host), team, 1, 1, router)
    }

    fn reading(robot: u16) -> Wire {
        Wire::Reading(Reading { robot: RobotId(robot), stamp_ns: 1, motion: Motion::default() })
    }

    fn handle(network: &mut Network, input: In) -> Vec<Out> {
        let mut out = Vec::new();
        network.handle(Time::ZERO, input, &mut out);
        out
    }

    fn frame(network: &mut Network, robot: u16) -> Frame {
        let out = handle(network, In::Publish(reading(robot)));
        let tapped = out.into_iter().find_map(|said| if let Out::Tap(frame) = said { Some(frame) } else { None });
        tapped.expect("everything that is published is tapped")
    }

    #[test]
    fn a_message_goes_where_the_table_says() {
        let mut network = network(1, 0);
        let out = handle(&mut network, In::Publish(reading(0)));
        assert!(matches!(&out[..], [Out::Tap(_), Out::Deliver(_)]), "{out:?}");
        let out = handle(&mut network, In::Publish(reading(1)));
        assert!(matches!(&out[..], [Out::Transmit(LINK, Audience::Host(HostId(9)), _), Out::Tap(_)]), "{out:?}");
        assert!(handle(&mut network, In::Publish(reading(2))).len() == 1, "nobody takes it; it is tapped all the same");
    }

    #[test]
    fn a_frame_is_let_in_once_or_counted() {
        let (mut here, mut there) = (network(1, 0), network(2, 0));
        let sound = frame(&mut there, 0);
        assert!(matches!(&handle(&mut here, In::Frame(LINK, sound.clone()))[..], [Out::Deliver(_)]));
        let other_team = frame(&mut network(3, 5), 0);
        let own = frame(&mut network(1, 0), 0);
        let elsewhere = frame(&mut there, 1);
        let mut version = sound.to_vec();
        version[0] += 1;
        let cut: Frame = sound[..sound.len() - 1].into();
        for refused in [sound, other_team, own, elsewhere, version.into(), cut] {
            assert!(handle(&mut here, In::Frame(LINK, refused)).is_empty());
        }
        let mut out = Vec::new();
        here.wake(Time::ZERO, &mut out);
        let [Out::Counts(counts)] = &out[..] else { panic!("it tells its counts: {out:?}") };
        let LinkCounts { accepted, duplicate, team, own, misrouted, version, malformed, .. } = *counts;
        assert_eq!([accepted, duplicate, team, own, misrouted, version, malformed], [1; 7]);
        assert_eq!(counts.refused(), 6);
    }
}
