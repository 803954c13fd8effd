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
                tracing::error!(robot = message.robot().0, "not sent: {error}");
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
        out.push(Out::Counts(self.links.iter().map(LinkState::counts).sum()));
        self.next_counts = now.next_on_grid(Span::ZERO, COUNTS_PERIOD);
    }
}
