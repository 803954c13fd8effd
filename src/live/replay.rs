//! Replay of a host from its record: the same actors with the recorded times and inputs, without sockets, drivers and
//! sources.

use std::os::fd::AsFd;
use std::os::unix::net::UnixDatagram;
use std::rc::Rc;

use super::links::{self, ProcessIdentity};
use super::{LiveHost, OpenError, grace};
use crate::actors::recorder::Out;
use crate::deploy::team::Team;
use crate::graph::devices::{self, Workers};
use crate::graph::end::HostEnd;
use crate::graph::event::Event;
use crate::graph::host;
use crate::graph::inputs::Input;
use crate::graph::process::Graph;
use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::key::Key;
use crate::net::transport::{Counts, In, Transport};
use crate::registry::Registry;
use crate::runtime::replay::run_replayed;
use crate::time::Time;
use crate::trial::Trial;

/// Transport for a replay, in place of a socket: receives nothing, and discards every datagram that is sent.
struct Silent(Rc<UnixDatagram>);

impl Transport for Silent {
    fn descriptor(&self) -> Rc<dyn AsFd> {
        Rc::clone(&self.0) as Rc<dyn AsFd>
    }

    fn receive(&mut self, _: Time, _: &mut dyn FnMut(Option<std::net::SocketAddr>, &[u8])) {}

    fn handle(&mut self, _: Time, _: In) {}

    fn counts(&self) -> Counts {
        Counts::default()
    }
}

impl LiveHost {
    /// Creates the host of a recorded process for [`LiveHost::run_again`], without opening sockets, drivers or sources.
    /// The recorded identity of the process and the number of transports of each link are in the last argument.
    pub fn closed(
        team: &Team,
        trial: &Trial,
        key: Option<Key>,
        registry: &Registry,
        (identity, transports): (&ProcessIdentity, &[usize]),
    ) -> Result<LiveHost, OpenError> {
        let links = links::setups(&team.deployment, team.links.iter().map(Option::as_ref));
        let entry = &team.deployment.hosts[usize::from(team.host.0)];
        let devices = devices::closed(entry, trial, registry)?;
        let ids = (0..=u16::MAX).map(LinkId).zip(transports).flat_map(|(link, count)| (0..*count).map(move |_| link));
        let silent = |link| {
            let never = UnixDatagram::unbound().expect("a process may have a descriptor");
            (link, Box::new(Silent(Rc::new(never))) as Box<dyn Transport>)
        };
        let me = identity.host_of(team);
        let end = HostEnd { me, key, seed: identity.seed, links, keep: None, transports: ids.map(silent).collect() };
        let (workers, trial) = (Workers::default(), trial.clone());
        Ok(LiveHost { end, devices, workers, trial, grace: grace(team), seed: identity.bytes })
    }

    /// Replays the host from the recorded turns of its event loop, and returns its actors. `begun` is the time at which
    /// the recorded run began; `turns` has the time and the inputs of each turn. `heard` is called with each event of
    /// the host, `said` with each output of its Recorder, and `ended` with the time at the end of each turn.
    pub fn run_again(
        self,
        begun: Time,
        turns: impl Iterator<Item = (Time, Vec<Input>)>,
        heard: impl Fn(HostId, Event) + 'static,
        said: impl FnMut(Out) + 'static,
        mut ended: impl FnMut(Time),
    ) -> Rc<Graph> {
        let LiveHost { end, devices, trial, .. } = self;
        let id = end.me.host;
        run_replayed(
            begun,
            |clock, readers| host::wire((clock, readers), trial, (end, devices), heard, said),
            turns,
            // Orders of the host's own process were recorded at the end of their turn.
            |graph, inputs| inputs.extract_if(.., |input| !input.is_order()).for_each(|input| graph.take(id, input)),
            |graph, now, orders| {
                orders.into_iter().for_each(|order| graph.take(id, order));
                ended(now);
            },
        )
    }
}
