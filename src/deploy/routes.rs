//! Routes of a deployment: publishers, receivers and link of every message. Memory and time are linear in the size of
//! the team, except for queries over all hosts.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::Deployment;
use crate::config::ConfigError;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{KINDS, Kind, Publisher, Receiver};
use crate::net::protocol::router::{Audience, Publishers, Route, Router};
use crate::safety::Switch;

/// For all actors of a checked deployment, the hosts on which they run; for all messages, the hosts and links between
/// which they go.
#[derive(Clone, Debug)]
pub struct Routes {
    robots: usize,
    /// For each robot: host of its Agent. `agent_robots` has the robots of that Agent, in the order of their ids.
    agent_host: Vec<HostId>,
    agent_robots: Vec<Arc<[RobotId]>>,
    /// For each robot: host that drives its motors. `localizer_host` has the host that measures it, `world_host` that
    /// of the World that simulates it (`None` for a real robot).
    actuator_host: Vec<HostId>,
    localizer_host: Vec<HostId>,
    world_host: Vec<Option<HostId>>,
    /// For each robot: hosts that receive its readings, sorted by id.
    reading_hosts: Vec<Vec<HostId>>,
    /// Whether what robots say of themselves is held against the readings of them.
    witness: Switch,
    /// Whether the robots have senses.
    senses: bool,
    server_host: HostId,
    /// For each host: robots whose Agents it runs, or which it drives or measures.
    robots_of: Vec<Vec<RobotId>>,
    /// For each host: number of robots whose Agents it runs.
    agent_counts: Vec<usize>,
    /// Hosts with an Agent, sorted. `mode_hosts` has all hosts, which receive instructions; `stop_hosts` has those with
    /// an Agent or a Body, and that of the state server.
    agent_hosts: Vec<HostId>,
    mode_hosts: Vec<HostId>,
    /// Hosts that measure robots, sorted.
    localizer_hosts: Vec<HostId>,
    stop_hosts: Vec<HostId>,
    publishers: Arc<Publishers>,
    /// For each kind of message: link that carries it.
    links: Vec<Option<LinkId>>,
}

/// Receivers of a message: all hosts of a sorted list, except the host `except` if it is not `None`.
#[derive(Clone, Copy, Debug)]
struct Receivers<'a> {
    hosts: &'a [HostId],
    except: Option<HostId>,
}

impl Receivers<'_> {
    fn has(&self, host: HostId) -> bool {
        self.except != Some(host) && self.hosts.binary_search(&host).is_ok()
    }

    fn iter(&self) -> impl Iterator<Item = HostId> {
        self.hosts.iter().copied().filter(|host| self.except != Some(*host))
    }
}

/// Returns the hosts that need a robot's readings for control: `agent`, that of its Agent; `driver`, that of its
/// motors, for the heading, if it is real; and the hosts in `worlds`, whose Worlds simulate other robots, which may
/// touch it.
fn readers(agent: HostId, driver: HostId, own_world: Option<HostId>, worlds: &[HostId]) -> Vec<HostId> {
    let driver = Some(driver).filter(|_| own_world.is_none());
    let worlds = worlds.iter().copied().filter(|host| own_world != Some(*host));
    [agent].into_iter().chain(driver).chain(worlds).collect()
}

/// Hosts on which the actors of each robot run, and robots of each host: the fields of [`Routes`] of these names.
struct Places {
    agent_host: Vec<HostId>,
    agent_robots: Vec<Arc<[RobotId]>>,
    actuator_host: Vec<HostId>,
    localizer_host: Vec<HostId>,
    world_host: Vec<Option<HostId>>,
    robots_of: Vec<Vec<RobotId>>,
}

impl Places {
    fn of(deployment: &Deployment) -> Places {
        let robots = deployment.robots;
        let [mut agent_host, mut actuator_host, mut localizer_host, mut world_host] =
            [(); 4].map(|()| vec![None; robots]);
        let mut agent_robots: Vec<Arc<[RobotId]>> = vec![Arc::default(); robots];
        let mut robots_of = Vec::new();
        for (index, host) in deployment.hosts.iter().enumerate() {
            let me = Some(HostId(number(index)));
            for agent in &host.agents {
                let ids: BTreeSet<RobotId> = agent.iter().copied().map(RobotId).collect();
                let ids: Arc<[RobotId]> = ids.into_iter().collect();
                for robot in ids.iter() {
                    agent_host[robot.index()] = me;
                    agent_robots[robot.index()] = Arc::clone(&ids);
                }
            }
            let mark = |hosts: &mut [Option<HostId>], robots: &[u16]| {
                robots.iter().for_each(|robot| hosts[usize::from(*robot)] = me);
            };
            mark(&mut actuator_host, &host.actuates);
            mark(&mut localizer_host, &host.localizes);
            for hosts in [&mut world_host, &mut actuator_host, &mut localizer_host] {
                mark(hosts, &host.simulates);
            }
            let bodies = host.simulates.iter().chain(&host.actuates).chain(&host.localizes);
            // A set, as a host may run both the Agent and the Body of a robot.
            let robots: BTreeSet<RobotId> = host.agents.iter().flatten().chain(bodies).copied().map(RobotId).collect();
            robots_of.push(robots.into_iter().collect());
        }
        let found = |hosts: Vec<Option<HostId>>| -> Vec<HostId> {
            hosts.into_iter().map(|host| host.expect("a checked deployment has a host for everything")).collect()
        };
        let [agent_host, actuator_host, localizer_host] = [agent_host, actuator_host, localizer_host].map(found);
        Places { agent_host, agent_robots, actuator_host, localizer_host, world_host, robots_of }
    }
}

/// Returns the number of a host or a link as it is in ids.
fn number(index: usize) -> u16 {
    u16::try_from(index).expect("a checked deployment has few hosts and links")
}

impl Routes {
    /// Computes the routes of a deployment. Panics if a robot has no Agent, Body or source of readings, which
    /// `Deployment::check` excludes.
    pub fn of(deployment: &Deployment) -> Routes {
        let Places { agent_host, agent_robots, actuator_host, localizer_host, world_host, robots_of } =
            Places::of(deployment);
        let server = deployment.hosts.iter().position(|host| host.state_server);
        let server_host = HostId(number(server.expect("a checked deployment has a state server")));
        let carried = |kind: Kind| if kind.follows_the_stop() { Kind::Stop } else { kind };
        let link_of = |kind: Kind| deployment.links.iter().position(|link| link.carries.contains(&carried(kind)));
        let hosts = |some: &[HostId], more: &[HostId]| -> Vec<HostId> {
            some.iter().chain(more).copied().collect::<BTreeSet<HostId>>().into_iter().collect()
        };
        let judge = deployment.judge_of_readings();
        let simulates = |host: &usize| !deployment.hosts[*host].simulates.is_empty();
        let worlds: Vec<HostId> = (0..deployment.hosts.len()).filter(simulates).map(|at| HostId(number(at))).collect();
        let agent_hosts = hosts(&agent_host, &[]);
        let reading_hosts = |at: usize| {
            let readers = readers(agent_host[at], actuator_host[at], world_host[at], &worlds);
            // A host that measures its own robot is no witness of it: it would say the same twice.
            let witnesses = deployment.witness == Switch::On && localizer_host[at] != agent_host[at];
            let witnesses = agent_hosts.iter().filter(|_| witnesses).copied();
            hosts(&readers, &judge.into_iter().chain(witnesses).collect::<Vec<_>>())
        };
        Routes {
            robots: deployment.robots,
            agent_robots,
            server_host,
            robots_of,
            agent_counts: deployment.hosts.iter().map(|host| host.agents.iter().map(Vec::len).sum()).collect(),
            mode_hosts: (0..deployment.hosts.len()).filter_map(|host| u16::try_from(host).ok()).map(HostId).collect(),
            // All hosts that move robots, and the state server's.
            stop_hosts: hosts(&hosts(&agent_host, &actuator_host), &[server_host]),
            localizer_hosts: hosts(&localizer_host, &[]),
            publishers: Arc::new(Publishers {
                names: deployment.hosts.iter().map(|host| host.name.clone()).collect(),
                agents: agent_host.clone(),
                actuators: actuator_host.clone(),
                localizers: localizer_host.clone(),
                server: server_host,
            }),
            links: KINDS.iter().map(|&kind| link_of(kind).map(|index| LinkId(number(index)))).collect(),
            reading_hosts: (0..deployment.robots).map(reading_hosts).collect(),
            witness: deployment.witness,
            senses: !deployment.sense_names().is_empty(),
            agent_hosts,
            agent_host,
            actuator_host,
            localizer_host,
            world_host,
        }
    }

    fn receivers(&self, kind: Kind, robot: RobotId) -> Receivers<'_> {
        let (mut hosts, mut except) = (&self.agent_hosts[..], None);
        match kind.receiver() {
            Receiver::Readers => hosts = &self.reading_hosts[robot.index()],
            Receiver::Actuator => hosts = std::slice::from_ref(&self.actuator_host[robot.index()]),
            Receiver::Perceiver if self.senses => hosts = std::slice::from_ref(&self.agent_host[robot.index()]),
            Receiver::Perceiver => hosts = &[],
            Receiver::StateServer => hosts = std::slice::from_ref(&self.server_host),
            Receiver::All => hosts = &self.mode_hosts,
            Receiver::Movers => hosts = &self.stop_hosts,
            Receiver::Localizers => hosts = &self.localizer_hosts,
            Receiver::Nobody => hosts = &[],
            Receiver::OtherAgents => {
                // Robots of one Agent exchange messages within its step, without sending them.
                let host = self.agent_host(robot);
                except = (self.agent_robots(robot).len() == self.agent_counts[usize::from(host.0)]).then_some(host);
            }
        }
        Receivers { hosts, except }
    }

    /// Returns the robots whose Agents or Bodies the host with this index runs, or which it measures.
    pub(crate) fn robots_of(&self, host: usize) -> &[RobotId] {
        &self.robots_of[host]
    }

    /// Returns the table of which host may publish which kind of message about which robot.
    pub fn publishers(&self) -> Arc<Publishers> {
        Arc::clone(&self.publishers)
    }

    /// Returns the host that runs the robot's Agent.
    pub fn agent_host(&self, robot: RobotId) -> HostId {
        self.agent_host[robot.index()]
    }

    /// Returns the host that drives the robot's motors.
    pub(crate) fn actuator_host(&self, robot: RobotId) -> HostId {
        self.actuator_host[robot.index()]
    }

    /// Returns the host whose Localizer publishes the robot's readings.
    pub(crate) fn localizer_host(&self, robot: RobotId) -> HostId {
        self.localizer_host[robot.index()]
    }

    /// Returns whether what the robot says of itself is held against its readings: another host than that of its Agent
    /// measures it, and the deployment has a witness.
    pub(crate) fn is_witnessed(&self, robot: RobotId) -> bool {
        self.witness == Switch::On && self.localizer_host(robot) != self.agent_host(robot)
    }

    /// Returns the host whose World simulates the robot; `None` for a real robot.
    pub(crate) fn world_host(&self, robot: RobotId) -> Option<HostId> {
        self.world_host[robot.index()]
    }

    /// Returns the host that runs the state server.
    pub fn server_host(&self) -> HostId {
        self.server_host
    }

    /// Returns all robots of the Agent that drives `robot`, including `robot`, in the order of their ids.
    pub(crate) fn agent_robots(&self, robot: RobotId) -> &[RobotId] {
        &self.agent_robots[robot.index()]
    }

    /// Returns the host that publishes messages of kind `kind` about `robot`; `None` if any host may.
    fn publisher(&self, kind: Kind, robot: RobotId) -> Option<HostId> {
        match kind.publisher() {
            Publisher::Localizer => Some(self.localizer_host(robot)),
            Publisher::Agent => Some(self.agent_host(robot)),
            Publisher::Actuator => Some(self.actuator_host(robot)),
            Publisher::StateServer => Some(self.server_host),
            Publisher::Member | Publisher::Operator | Publisher::Anyone => None,
        }
    }

    /// Whether messages of this kind are sent from one host to another in this deployment.
    pub fn crosses(&self, kind: Kind) -> bool {
        RobotId::team(self.robots).any(|robot| {
            let from = self.publisher(kind, robot);
            // Messages that any host may publish cross hosts if there is more than one host.
            self.robots_of.len() > 1 && self.receivers(kind, robot).iter().any(|to| Some(to) != from)
        })
    }

    /// Whether `host` exchanges messages of this kind with other hosts.
    pub fn exchanges(&self, host: HostId, kind: Kind) -> bool {
        RobotId::team(self.robots).any(|robot| {
            let (from, receivers) = (self.publisher(kind, robot), self.receivers(kind, robot));
            let sends = from.is_none_or(|from| from == host) && receivers.iter().any(|to| to != host);
            sends || (from != Some(host) && receivers.has(host))
        })
    }

    /// Returns all hosts that receive messages of the kind `kind`, whichever robot these are about.
    pub fn listeners(&self, kind: Kind) -> Vec<HostId> {
        let receivers = |robot| self.receivers(kind, robot);
        // These lists are the same for all robots, except that one host may be left out for a robot.
        let of_all = match kind.receiver() {
            Receiver::Readers | Receiver::Actuator | Receiver::Perceiver => {
                RobotId::team(self.robots).flat_map(|robot| receivers(robot).hosts).copied().collect()
            }
            _ => {
                let receives = |host: &HostId| RobotId::team(self.robots).any(|robot| receivers(robot).has(*host));
                receivers(RobotId(0)).hosts.iter().copied().filter(receives).collect::<BTreeSet<HostId>>()
            }
        };
        of_all.into_iter().collect()
    }

    /// Returns the routing table of a host: for each kind of message and robot, whether the host receives it and on
    /// which link it sends it.
    pub fn router(&self, host: HostId) -> Router {
        // With a witness, readings of others arrive here, but those of robots without one do not.
        let alone = |robot: &RobotId| self.witness == Switch::On && !self.is_witnessed(*robot);
        let apart = self.robots_of(usize::from(host.0)).iter().copied();
        let apart = apart.chain(RobotId::team(self.robots).filter(alone)).collect();
        let router = Router::of(self.robots, apart, |kind, robot| {
            let receivers = self.receivers(kind, robot);
            let local = receivers.has(host);
            let mut others = receivers.iter().filter(|&taker| taker != host);
            let audience = match (others.next(), others.next()) {
                _ if kind.is_for_operators() => self.links[kind as usize].map(|_| Audience::All),
                (None, _) => None,
                (Some(only), None) => Some(Audience::Host(only)),
                _ => Some(Audience::All),
            };
            let publishes = self.publisher(kind, robot).is_none_or(|publisher| publisher == host);
            let link = || self.links[kind as usize].expect("a checked deployment has a link for all that crosses");
            Route { local, leaves: audience.filter(|_| publishes).map(|audience| (link(), audience)) }
        });
        router.with_publishers(Arc::clone(&self.publishers))
    }
}

impl Deployment {
    /// Checks that a witness has something to witness.
    pub(super) fn check_witness(&self) -> Result<(), ConfigError> {
        let witnesses = |routes: Routes| RobotId::team(self.robots).any(|robot| routes.is_witnessed(robot));
        if self.witness == Switch::On && !witnesses(Routes::of(self)) {
            let reason = "no robot is measured by another host than that of its agent; set it to \"off\"";
            return Err(ConfigError::field("witness", reason.to_owned()));
        }
        Ok(())
    }
}
