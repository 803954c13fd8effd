//! The routing table of one host: for a message, whether it has takers here, and which link it leaves on.
//!
//! The table is data, made from the deployment; nothing here knows a deployment mode.

use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{KINDS, Kind};

/// Whom a frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Audience {
    /// Every other host on the link.
    All,
    /// One host.
    Host(HostId),
}

/// The way of one message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Route {
    /// Somebody on this host takes it.
    pub local: bool,
    /// It leaves on this link, for these hosts.
    pub leaves: Option<(LinkId, Audience)>,
}

/// The ways of all messages that this host publishes or receives.
#[derive(Clone, Debug)]
pub struct Router {
    robots: usize,
    /// By kind, then by robot.
    routes: Vec<Route>,
}

impl Router {
    /// A table for `robots` robots, filled in by `route`.
    pub fn new(robots: usize, mut route: impl FnMut(Kind, RobotId) -> Route) -> Router {
        let routes = KINDS.iter().flat_map(|&kind| RobotId::team(robots).map(move |robot| (kind, robot)));
        Router { robots, routes: routes.map(|(kind, robot)| route(kind, robot)).collect() }
    }

    /// The way of a message of this kind about this robot; none if there is no such robot.
    pub fn route(&self, kind: Kind, robot: RobotId) -> Route {
        if robot.index() >= self.robots {
            return Route::default();
        }
        self.routes[kind as usize * self.robots + robot.index()]
    }
}
