//! The part of a Network for links on which not all hosts hear each other: it says emergency stops on, and passes on
//! the soft state of others.

use std::collections::BTreeMap;

use super::{Network, Out, Route, transmit};
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{Kind, Stop, Wire};
use crate::net::protocol::codec::{self, Content};
use crate::net::protocol::counts::LinkCounts;
use crate::net::protocol::flood::{Flood, NEIGHBOUR};
use crate::net::protocol::link::{Identity, LinkState};
use crate::net::protocol::relay::{Block, Relay};
use crate::net::protocol::report::Report;
use crate::net::protocol::router::Audience;
use crate::net::protocol::sender::Peer;
use crate::net::protocol::ways::{Overheard, Ways};
use crate::random::Stream;
use crate::time::Time;

/// Largest number of pairs of hosts that an operator keeps: those of a team of 64.
const MOST_OVERHEARD: usize = 4096;

/// Links of one host that are a mesh, and what it says on.
#[derive(Debug)]
pub(super) struct Mesh {
    links: Vec<LinkId>,
    /// Emergency stops; `None` at an operator, which passes nothing on.
    flood: Option<Flood>,
    relay: Relay,
    /// Neighbours that pass nothing on, as the log has said.
    withholders: Vec<HostId>,
    /// Hosts that each neighbour hears: its loss of 64, and the time at which it said so. Kept by operators alone.
    overheard: BTreeMap<(HostId, HostId), (u8, Time)>,
}

impl Mesh {
    /// Returns the mesh of a host on these links; `None` without links. `server` is the host of the state server.
    pub(super) fn new(me: Identity, links: Vec<LinkId>, server: HostId, stream: &mut Stream) -> Option<Mesh> {
        let flood = (!me.host.is_operator()).then(Flood::new);
        (!links.is_empty()).then(|| Mesh {
            links,
            flood,
            relay: Relay::new(me, server, stream),
            withholders: Vec::new(),
            overheard: BTreeMap::new(),
        })
    }

    /// Returns the counts of entries.
    pub(super) fn counts(&self) -> LinkCounts {
        self.relay.counts()
    }

    /// Takes note of whom the neighbour `from`, a host of the team, hears by the link report in its datagram.
    fn overhear(&mut self, now: Time, from: HostId, plain: &[u8]) {
        for (content, body) in codec::blocks(plain).flatten() {
            let Ok(report) = Report::read(content, body) else { continue };
            for entry in report.heard.iter().filter(|entry| !entry.host.is_operator() && entry.host != from) {
                if self.overheard.len() < MOST_OVERHEARD || self.overheard.contains_key(&(from, entry.host)) {
                    self.overheard.insert((from, entry.host), (entry.lost, now));
                }
            }
        }
    }

    pub(super) fn due(&self) -> Option<Time> {
        let said = self.flood.as_ref().and_then(Flood::due);
        said.into_iter().chain(self.relay.due()).min()
    }
}

impl Network {
    /// Whether a link is part of the mesh, on which this host passes on what others say.
    pub(super) fn is_mesh(&self, link: LinkId) -> bool {
        self.mesh.as_ref().is_some_and(|mesh| mesh.flood.is_some() && mesh.links.contains(&link))
    }

    /// Takes note of the emergency stop, or its end, in a message of the host `from`.
    pub(super) fn note_latch(&mut self, now: Time, from: HostId, message: &Wire) {
        let Some(flood) = self.mesh.as_mut().and_then(|mesh| mesh.flood.as_mut()) else { return };
        // Where members have keys of their own, an operator's signature alone ends a stop.
        let signed = self.key.as_ref().is_some_and(|key| key.signatures().is_some());
        match message {
            Wire::Stop(stop) if stop.latch.is_engaged() => flood.hear(now, from, stop.latch, &mut self.stream),
            // A resume ends a hold and no stop.
            Wire::Stop(stop) if stop.latch.is_held() && stop.by.is_operator() && !signed => flood.end(stop.latch),
            Wire::Release(release) if release.latch.is_held() => flood.end(release.latch),
            Wire::Mode(mode) if !mode.latch.is_engaged() && !signed => flood.end(mode.latch),
            _ => {}
        }
    }

    /// Takes a message that this host publishes, to be said across hops if it is of such a kind.
    pub(super) fn say_across_hops(&mut self, now: Time, message: &Wire) {
        let says = message.kind().crosses_hops();
        if let Some(mesh) = self.mesh.as_mut().filter(|mesh| says && mesh.flood.is_some()) {
            mesh.relay.put(now, message);
        }
    }

    /// Takes note of a message that has come from its publisher itself. A release of an operator is passed on.
    pub(super) fn note_direct(&mut self, now: Time, from: HostId, message: &Wire) {
        self.note_latch(now, from, message);
        let Some(mesh) = self.mesh.as_mut().filter(|_| message.kind().crosses_hops()) else { return };
        mesh.relay.note_direct(now, from, message);
        if message.kind() == Kind::Release && from.is_operator() && mesh.flood.is_some() {
            mesh.relay.put(now, message);
        }
    }

    /// Puts entries into the next datagram with data on a link of the mesh, before this message.
    pub(super) fn carry(&mut self, now: Time, link: LinkId, message: &Wire) {
        if message.kind() != Kind::Latent || !self.is_mesh(link) {
            return;
        }
        let Some(mesh) = &mut self.mesh else { return };
        let block = mesh.relay.choose(now, self.key.as_ref());
        if let Some(state) = self.links[usize::from(link.0)].as_mut() {
            state.carry(block);
        }
    }

    /// Takes note of the entries that have left on a link.
    pub(super) fn have_carried(&mut self, now: Time, link: LinkId) {
        let Some(mesh) = &mut self.mesh else { return };
        let Some(state) = self.links[usize::from(link.0)].as_mut() else { return };
        let block = state.carried();
        if !block.is_empty() {
            mesh.relay.said(now, &block.entries);
        }
    }

    /// Takes the entries in an admitted datagram of the host `from` on a link; one without entries counts, too.
    pub(super) fn hear_entries(&mut self, now: Time, (link, from): (LinkId, HostId), plain: &[u8], out: &mut Vec<Out>) {
        let Some(mesh) = self.mesh.as_mut().filter(|mesh| mesh.links.contains(&link)) else { return };
        let found = codec::blocks(plain).flatten().find(|(content, _)| *content == Content::Relayed);
        let block = found.map(|(_, body)| Block::read(body)).unwrap_or_default();
        let (router, key) = (&self.router, self.key.as_ref());
        if mesh.flood.is_none() && !from.is_operator() {
            mesh.overhear(now, from, plain);
        }
        let permits = |origin, message: &Wire| {
            message.robot().index() < router.robots() && router.forbids(origin, message).is_none()
        };
        for (origin, message) in mesh.relay.hear(now, from, &block, key, permits) {
            self.note_latch(now, origin, &message);
            if self.router.route(message.kind(), message.robot()).local {
                out.push(Out::Deliver(message));
            }
        }
    }

    /// Returns by which ways this host hears others over hops, and sends on links that choose.
    pub(super) fn ways(&self, now: Time) -> Ways {
        let Network { mesh, links, .. } = self;
        let overheard = mesh.iter().flat_map(|mesh| &mesh.overheard);
        let overheard = overheard.map(|(pair, (lost, since))| Overheard::new(*pair, *lost, now.since(*since)));
        Ways {
            hops: mesh.as_ref().map(|mesh| mesh.relay.last_hops(now)),
            overheard: overheard.collect(),
            sends: links.iter().flatten().filter_map(|link| link.sending(now)).collect(),
        }
    }

    /// Marks the peers that pass nothing on, and says in the log when one begins or ends to.
    pub(super) fn note_withholders(&mut self, now: Time, peers: &mut [Peer]) {
        let Some(mesh) = &mut self.mesh else { return };
        let found = mesh.relay.withholders(now);
        for host in found.iter().filter(|host| !mesh.withholders.contains(host)) {
            tracing::warn!("host {} passes nothing on of what others say: look at it, or take it out", host.0);
        }
        for host in mesh.withholders.iter().filter(|host| !found.contains(host)) {
            tracing::info!("host {} passes on again, or is not heard any more", host.0);
        }
        for peer in peers.iter_mut().filter(|peer| found.contains(&HostId(peer.host))) {
            peer.withholds = mesh.links.contains(&LinkId(peer.link));
        }
        mesh.withholders = found;
    }

    /// Says what is due on the mesh: an emergency stop, and entries that no datagram with data has taken.
    pub(super) fn wake_mesh(&mut self, now: Time, out: &mut Vec<Out>) {
        let (links, me) = (&self.links, self.local_header.sender);
        let Some(mesh) = &mut self.mesh else { return };
        let on_mesh = mesh.links.iter().filter_map(|link| links[usize::from(link.0)].as_ref());
        let neighbours = on_mesh.flat_map(|state: &LinkState| state.neighbours(now, NEIGHBOUR));
        let stop = mesh.flood.as_mut().and_then(|flood| flood.next(now, neighbours, &mut self.stream));
        let links = mesh.links.clone();
        if let Some(latch) = stop {
            for link in &links {
                let route = Route { local: false, leaves: Some((*link, Audience::All)) };
                self.send(now, route, &Wire::Stop(Stop { by: me, latch }), out);
            }
        }
        self.send_entries(now, &links, out);
    }

    fn send_entries(&mut self, now: Time, links: &[LinkId], out: &mut Vec<Out>) {
        let Some(mesh) = self.mesh.as_mut().filter(|mesh| mesh.relay.due().is_some_and(|due| due <= now)) else {
            return;
        };
        let block = mesh.relay.choose(now, self.key.as_ref());
        let mut said = Block::default();
        for link in links {
            let Some(state) = self.links[usize::from(link.0)].as_mut() else { continue };
            said = state.send_carried(now, block.clone(), &mut self.outgoing);
            self.due[usize::from(link.0)] = state.due();
            transmit(*link, &mut self.outgoing, out);
        }
        mesh.relay.said(now, &said.entries);
    }
}
