//! Routing table of one host: whether a message is delivered on this host, and on which link it is sent.
//!
//! The table is data made from the deployment, and independent of deployment modes.

use std::sync::Arc;

use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{KINDS, Kind, Publisher, Wire};

/// Hosts that a datagram is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Audience {
    /// Every other host on the link.
    All,
    /// The one host with this id.
    Host(HostId),
}

/// Route of a message at one host: whether it is delivered there, and on which link it is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Route {
    /// Whether the message is delivered on this host.
    pub local: bool,
    /// Link on which the message is sent, and its receivers; `None` if it stays on this host.
    pub leaves: Option<(LinkId, Audience)>,
}

/// Names of a team's hosts, and the messages that each may publish. Equal on all hosts.
#[derive(Clone, Debug)]
pub struct Publishers {
    /// Names of the hosts, indexed by host id.
    pub names: Vec<String>,
    /// For each robot, the host of its Agent.
    pub agents: Vec<HostId>,
    /// For each robot, the host that drives its motors and reports the condition of its hardware.
    pub actuators: Vec<HostId>,
    /// For each robot, the host that measures it.
    pub localizers: Vec<HostId>,
    /// Host of the state server.
    pub server: HostId,
}

impl Publishers {
    /// Returns whether the host `sender` may publish this message.
    pub(crate) fn permit(&self, sender: HostId, message: &Wire) -> bool {
        message.is_permitted(sender, |publisher, robot| {
            let of = |hosts: &[HostId]| hosts.get(robot.index()) == Some(&sender);
            match publisher {
                Publisher::Localizer => of(&self.localizers),
                Publisher::Agent => of(&self.agents),
                Publisher::Actuator => of(&self.actuators),
                Publisher::StateServer => sender == self.server,
                Publisher::Member => self.knows(sender),
                Publisher::Operator => sender.is_operator(),
                Publisher::Anyone => true,
            }
        })
    }

    fn knows(&self, host: HostId) -> bool {
        usize::from(host.0) < self.names.len()
    }

    /// Returns the name of a host for log messages.
    pub(crate) fn name(&self, host: HostId) -> String {
        match self.names.get(usize::from(host.0)) {
            Some(name) => format!("'{name}' (host {})", host.0),
            None if host.is_operator() => format!("operator {}", host.0),
            None => format!("host {}, which is in no team file,", host.0),
        }
    }
}

/// Routing table of one host: for each kind of message and robot, whether messages are delivered on the host, and on
/// which link they are sent.
#[derive(Clone, Debug)]
pub struct Router {
    robots: usize,
    /// Robots with routes of their own on this host, in order.
    mine: Vec<RobotId>,
    /// Routes of messages, grouped by kind in the order of `KINDS`. Each kind has `mine.len() + 1` entries: one for
    /// each robot in `mine`, in that order, then one for all other robots.
    routes: Vec<Route>,
    /// Hosts that may publish each message; `None` if there is no restriction.
    publishers: Option<Arc<Publishers>>,
}

impl Router {
    /// Returns the number of robots of the team.
    pub(crate) fn robots(&self) -> usize {
        self.robots
    }

    /// Creates a table for a team of `robots` robots; `route` is called for the route of each kind of message about
    /// each robot.
    pub fn new(robots: usize, route: impl FnMut(Kind, RobotId) -> Route) -> Router {
        Router::of(robots, RobotId::team(robots).collect(), route)
    }

    /// Creates a table for a team of `robots` robots, of which `mine` have routes of their own. `route` is called for
    /// the routes, and must return the same ones for all robots outside `mine`.
    pub(crate) fn of(robots: usize, mut mine: Vec<RobotId>, mut route: impl FnMut(Kind, RobotId) -> Route) -> Router {
        mine.sort();
        mine.dedup();
        let other = RobotId::team(robots)
            .zip(mine.iter().copied().map(Some).chain([None]))
            .find_map(|(robot, mine)| Some(robot).filter(|_| mine != Some(robot)));
        let mut routes = Vec::with_capacity(KINDS.len() * (mine.len() + 1));
        for kind in KINDS {
            routes.extend(mine.iter().map(|&robot| route(kind, robot)));
            routes.push(other.map_or(Route::default(), |robot| route(kind, robot)));
        }
        Router { robots, mine, routes, publishers: None }
    }

    /// Returns the table with the restriction that hosts may publish only the messages in `publishers`.
    pub fn with_publishers(self, publishers: Arc<Publishers>) -> Router {
        Router { publishers: Some(publishers), ..self }
    }

    /// Returns the host of the state server; host 0 if it is unknown.
    pub(crate) fn server(&self) -> HostId {
        self.publishers.as_ref().map_or(HostId(0), |publishers| publishers.server)
    }

    /// Returns the number of hosts in the team; `None` if unknown.
    pub(crate) fn hosts(&self) -> Option<u16> {
        self.publishers.as_ref().and_then(|publishers| u16::try_from(publishers.names.len()).ok())
    }

    /// Returns the sender's name if it may not publish this message; `None` if it may.
    pub(crate) fn forbids(&self, sender: HostId, message: &Wire) -> Option<String> {
        let publishers = self.publishers.as_ref()?;
        (!publishers.permit(sender, message)).then(|| publishers.name(sender))
    }

    /// Returns the route of a message of this kind about this robot. A message about an unknown robot is neither
    /// delivered nor sent.
    pub fn route(&self, kind: Kind, robot: RobotId) -> Route {
        if robot.index() >= self.robots {
            return Route::default();
        }
        let place = self.mine.binary_search(&robot).unwrap_or(self.mine.len());
        self.routes[kind as usize * (self.mine.len() + 1) + place]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::{Pose, Vec2};
    use crate::messages::ids::LinkId;
    use crate::messages::latch::Latch;
    use crate::messages::wire::{Heartbeat, Located, MotorCommand, Phase, Place, Round, Status, Stop, Whereabouts};
    use crate::time::Span;

    /// Robot 0 has its agent on host 0, robot 1 on host 1; the bodies and the state server are on host 2.
    fn publishers() -> Publishers {
        Publishers {
            names: ["a", "b", "c"].map(str::to_owned).to_vec(),
            agents: vec![HostId(0), HostId(1)],
            actuators: vec![HostId(2); 2],
            localizers: vec![HostId(2); 2],
            server: HostId(2),
        }
    }

    #[test]
    fn a_host_may_say_what_the_deployment_gives_it_to_say_and_nothing_else() {
        let robot = RobotId(1);
        let command = Wire::MotorCommand(MotorCommand { robot, velocity: Vec2::zeros(), valid_for: Span::ZERO });
        let (round, phase, latch) = (Round::default(), Phase::Running, Latch::default());
        let beat = Wire::Heartbeat(Heartbeat::new(robot, round, phase, latch));
        let operator = HostId::operator(5);
        for message in [&command, &beat] {
            let permitted: Vec<u16> = [0, 1, 2, 77, operator.0]
                .into_iter()
                .filter(|&host| publishers().permit(HostId(host), message))
                .collect();
            assert_eq!(permitted, [1], "{message:?}");
        }
        let beyond =
            Wire::MotorCommand(MotorCommand { robot: RobotId(9), velocity: Vec2::zeros(), valid_for: Span::ZERO });
        assert!(!publishers().permit(HostId(1), &beyond), "there is no such robot");
    }

    #[test]
    fn anyone_may_stop_and_only_operators_and_the_state_server_may_resume_each_in_its_own_name() {
        let (stranger, operator) = (HostId(77), HostId::operator(5));
        let may =
            |sender: HostId, by: HostId, latch: Latch| publishers().permit(sender, &Wire::Stop(Stop { by, latch }));
        assert!(may(stranger, stranger, Latch::engaged(1)), "a stop is never refused");
        for latch in [Latch::held(2), Latch::clear(3)] {
            assert!(!may(stranger, stranger, latch) && !may(stranger, operator, latch));
            assert!(may(operator, operator, latch) && may(HostId(2), HostId(2), latch));
            assert!(!may(HostId(1), HostId(2), latch), "in another's name");
            assert_eq!(may(HostId(1), HostId(1), latch), latch.is_held(), "a robot's host repeats a hold");
        }
        let status = |host| Wire::Status(Status::of(host, true, Vec::new(), None));
        assert!(publishers().permit(HostId(1), &status(HostId(1))));
        assert!(
            !publishers().permit(HostId(1), &status(HostId(2))) && !publishers().permit(stranger, &status(stranger))
        );
        assert!(
            publishers().name(stranger).contains("in no team file") && publishers().name(HostId(1)).contains("'b'")
        );
    }

    #[test]
    fn operators_alone_place_robots_and_a_host_that_measures_a_robot_alone_says_where_it_is() {
        let (robot, pose, operator) = (RobotId(1), Pose::default(), HostId::operator(5));
        let place = |by| Wire::Place(Place { by, number: 1, robot, pose });
        assert!(publishers().permit(operator, &place(operator)));
        assert!(!publishers().permit(HostId(0), &place(HostId(0))), "a host of the team has not looked");
        assert!(!publishers().permit(HostId::operator(6), &place(operator)), "in another's name");
        let located = |host, robot| {
            let robots = vec![(RobotId(robot), Whereabouts::Adrift)];
            Wire::Located(Located { host, robots, answer: None })
        };
        assert!(publishers().permit(HostId(2), &located(HostId(2), 1)));
        for (sender, host, robot) in [(0, 0, 1), (2, 0, 1), (2, 2, 9), (77, 77, 1)] {
            assert!(!publishers().permit(HostId(sender), &located(HostId(host), robot)), "{sender} {host} {robot}");
        }
    }

    #[test]
    fn a_table_of_some_robots_is_that_of_all() {
        let leaves = |robot: RobotId| Some((LinkId(0), Audience::Host(HostId(robot.0))));
        for mine in [vec![], vec![0, 1, 2], vec![4, 1], vec![0, 1, 2, 3, 4]] {
            let mine: Vec<RobotId> = mine.into_iter().map(RobotId).collect();
            let way = |kind: Kind, robot: RobotId| match (kind, mine.contains(&robot)) {
                (Kind::Reading, true) => Route { local: true, leaves: leaves(robot) },
                (Kind::Reading, false) => Route::default(),
                (_, own) => Route { local: !own, leaves: None },
            };
            let (all, some) = (Router::new(5, way), Router::of(5, mine.clone(), way));
            for (kind, robot) in KINDS.into_iter().flat_map(|kind| RobotId::team(7).map(move |robot| (kind, robot))) {
                assert_eq!(all.route(kind, robot), some.route(kind, robot), "{kind:?} about {robot}");
            }
        }
    }
}
