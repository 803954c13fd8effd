//! Serves the metrics of one host for `murmurate host --metrics`. The server has no page and takes no commands.

use std::cell::{Cell, RefCell};
use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, Result};

use crate::bad;
use crate::key::token;
use crate::output::talk;
use crate::own_name;
use murmurate::deploy::Routes;
use murmurate::deploy::team::Team;
use murmurate::graph::event::Event;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::time::{Span, Time};
use murmurate_view::access::{Access, Control};
use murmurate_view::metrics::Metrics;
use murmurate_view::server::{Publisher, Server};
use murmurate_view::status::Scene;
use murmurate_view::team_view::TeamView;

/// Period at which the metrics sample the ages of the messages in use.
const SAMPLE: Span = Span::from_millis(50);
/// Period at which the text of the metrics, which a request gets, is renewed.
const TEXT: Span = Span::from_millis(1000);

/// Flags of `murmurate host` for its metrics.
#[derive(clap::Args)]
pub struct MetricsFlags {
    /// Address at which /metrics and /healthz are served for Prometheus; one that other machines reach needs
    /// --metrics-token-file
    #[arg(long, value_name = "ADDRESS:PORT")]
    metrics: Option<SocketAddr>,
    /// File with the token that a reader of the metrics has to show, as 'murmurate key new' makes it
    #[arg(long, value_name = "FILE", requires = "metrics")]
    metrics_token_file: Option<PathBuf>,
}

/// Metrics of a running host, and the HTTP server that serves them.
pub struct HostMetrics {
    view: RefCell<TeamView>,
    metrics: RefCell<Metrics>,
    publisher: Publisher,
    _server: Server,
    now: Cell<Time>,
    sampled: Cell<Time>,
    told: Cell<Time>,
}

impl MetricsFlags {
    /// Fails if other machines can reach the address of the metrics but no token file is given.
    pub fn check(&self) -> Result<()> {
        match self.metrics {
            Some(listen) if is_guarded(listen) && self.metrics_token_file.is_none() => bad(format!(
                "--metrics: other machines reach {listen}, so a reader needs a token: make one with '{} key new \
                 --out metrics.token' and give --metrics-token-file metrics.token",
                own_name()
            )),
            _ => Ok(()),
        }
    }

    /// Starts the HTTP server of the metrics of the host `team.host`; returns `None` if the flag `--metrics` is not
    /// given.
    pub fn open(&self, team: &Team) -> Result<Option<HostMetrics>> {
        let Some(listen) = self.metrics else { return Ok(None) };
        let guarded = is_guarded(listen);
        let token = token(self.metrics_token_file.as_deref())?;
        let access = Access { token, control: Control::StopOnly, guarded, foxglove: false, page: false };
        let opened = Server::open(listen, access, String::new());
        let (server, publisher) = opened.with_context(|| format!("--metrics: cannot serve at {listen}"))?;
        talk(&format!("metrics: http://{}/metrics", server.address()));
        let (deployment, robots) = (&team.deployment, team.deployment.robots);
        let routes = Routes::of(deployment);
        let homes = RobotId::team(robots).map(|robot| routes.agent_host(robot)).collect();
        let view = TeamView::new(Scene { robots, ..Scene::default() }, homes, deployment.hosts.len());
        let names = deployment.hosts.iter().map(|host| host.name.clone()).collect();
        let (now, sampled, told) = Default::default();
        let (view, metrics) = (RefCell::new(view), RefCell::new(Metrics::new(names)));
        Ok(Some(HostMetrics { view, metrics, publisher, _server: server, now, sampled, told }))
    }
}

/// Whether other machines can reach this address: it is not a loopback address. A reader then needs a token.
fn is_guarded(listen: SocketAddr) -> bool {
    !listen.ip().to_canonical().is_loopback()
}

impl HostMetrics {
    /// Updates the metrics with an event of the host `host`.
    pub fn receive(&self, host: HostId, event: Event) {
        self.metrics.borrow_mut().take(host, event);
        let mut view = self.view.borrow_mut();
        match event {
            Event::Message(message) => view.receive(self.now.get(), message),
            Event::Safety(robot, counts) => view.guarded(self.now.get(), robot, counts),
            _ => {}
        }
    }

    /// Marks the end of a turn of the host's event loop at the time `now`: samples and publishes the metrics if this is
    /// due. `dropped` is the number of events that the host's record lacks; `None` without a record.
    pub fn turn(&self, now: Time, dropped: Option<u64>) {
        self.now.set(now);
        if now.since(self.sampled.get()) >= SAMPLE {
            self.sampled.set(now);
            self.metrics.borrow_mut().sample(&self.view.borrow().snapshot(now));
        }
        if now.since(self.told.get()) >= TEXT || self.told.get() == Time::ZERO {
            dropped.into_iter().for_each(|events| self.metrics.borrow_mut().dropped(events));
            if self.publisher.metrics(self.metrics.borrow().text(&self.view.borrow())) {
                self.told.set(now);
            }
        }
    }
}
