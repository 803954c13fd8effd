//! The live page that a command serves in a browser: its flags, its HTTP server, and the feed that updates it.

pub mod feed;
pub mod team;
pub mod trial;

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, Result};

use murmurate::messages::ids::HostId;
use murmurate_robot::bad;
use murmurate_robot::key::token;
use murmurate_robot::output::talk;
use murmurate_robot::own_name;
use murmurate_view::access::{Access, Control};
use murmurate_view::server::{Publisher, Server};
use murmurate_view::status::Scene;

/// Flags of the live page: address, permitted commands and token.
#[derive(clap::Args)]
pub struct PageFlags {
    /// Address at which the page is served; one that other machines reach needs --token-file [default: 127.0.0.1 and a
    /// free port]
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// Takes commands of the page beside the emergency stop: re-arm, resume, pause, and faults of a simulation
    #[arg(long)]
    control: bool,
    /// File with the token of the page, as 'murmurate key new' makes it [default: drawn, and printed with the address]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Lets Foxglove connect to the page's server, and prints the address for it (docs/watch.md)
    #[cfg_attr(feature = "foxglove", arg(long))]
    #[cfg_attr(not(feature = "foxglove"), arg(skip))]
    foxglove: bool,
}

/// Flags of a command that serves the live page if `--watch` is given.
#[derive(clap::Args)]
pub struct OptionalPage {
    /// Serves a page that shows the team while it runs, and prints its address (docs/watch.md)
    #[arg(long)]
    pub watch: bool,
    /// Flags of the page: address, permitted commands and token.
    #[command(flatten)]
    pub page: PageFlags,
}

impl OptionalPage {
    /// Fails if a flag of the page, such as `--listen`, is given without `--watch`.
    pub fn check(&self) -> Result<()> {
        let PageFlags { listen, control, token_file, foxglove } = &self.page;
        let given = [
            ("--listen", listen.is_some()),
            ("--control", *control),
            ("--token-file", token_file.is_some()),
            ("--foxglove", *foxglove),
        ];
        match given.iter().find(|(_, given)| *given && !self.watch) {
            Some((flag, _)) => bad(format!("{flag}: there is no page; add --watch")),
            None => Ok(()),
        }
    }
}

/// Flags of `replay` for the page that shows a record if `--watch` is given.
#[derive(clap::Args)]
pub struct RecordPage {
    /// Serves a page that shows the records with a scrubber, and prints its address (docs/watch.md)
    #[arg(long, conflicts_with_all = ["policy", "rerun", "host", "json"])]
    watch: bool,
    /// Address at which the page is served; one that other machines reach needs --token-file [default: 127.0.0.1 and a
    /// free port]
    #[arg(long, value_name = "ADDRESS:PORT", requires = "watch")]
    listen: Option<SocketAddr>,
    /// File with the token of the page, as 'murmurate key new' makes it [default: drawn, and printed with the address]
    #[arg(long, value_name = "FILE", requires = "watch")]
    token_file: Option<PathBuf>,
}

impl RecordPage {
    /// Returns true if the page was requested by `--watch`.
    pub fn is_on(&self) -> bool {
        self.watch
    }

    /// Starts the HTTP server of a page that plays a record, and prints the page's address. `scene` has the constant
    /// properties of the recorded run.
    pub fn open(&self, scene: Scene) -> Result<(Server, Publisher)> {
        let (listen, token_file) = (self.listen, self.token_file.clone());
        PageFlags { listen, control: true, token_file, foxglove: false }.open(scene, Control::Playback)
    }
}

impl PageFlags {
    /// Starts the HTTP server of the page, and prints the page's address. `scene` has the constant properties of the
    /// run. `most` are the commands that this process can execute: the page may give them with `--control`, and
    /// otherwise only the emergency stop.
    pub fn open(&self, mut scene: Scene, most: Control) -> Result<(Server, Publisher)> {
        let listen = self.listen.unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], 0)));
        let guarded = !listen.ip().to_canonical().is_loopback();
        if guarded && self.token_file.is_none() {
            return bad(format!(
                "--listen: other machines reach {listen}, so the page needs a token: make one with '{} key new \
                 --out page.token' and give --token-file page.token, or keep 127.0.0.1 and use an ssh tunnel",
                own_name()
            ));
        }
        let token = token(self.token_file.as_deref())?;
        let control = if self.control { most } else { Control::StopOnly };
        scene.control = match control {
            Control::StopOnly => "stop",
            Control::Team => "team",
            Control::Emulation => "emulation",
            Control::Playback => "playback",
        };
        // A token from a file is not printed.
        let secret = match &self.token_file {
            Some(file) => format!("#TOKEN, with the token that is in {}", file.display()),
            None if self.control => format!("#{}", token.digits()),
            None => String::new(),
        };
        let viewer = match &self.token_file {
            Some(_) => "TOKEN".to_owned(),
            None => token.digits().to_owned(),
        };
        let access = Access { token, control, guarded, foxglove: self.foxglove, page: true };
        let opened = Server::open(listen, access, scene.to_json());
        let (server, publisher) = opened.with_context(|| format!("--listen: cannot serve the page at {listen}"))?;
        talk(&format!("watch: http://{}/{secret}", server.address()));
        if self.foxglove {
            talk(&format!("foxglove: ws://{}/foxglove?token={viewer}", server.address()));
        }
        Ok((server, publisher))
    }
}

/// Host id with which the page of a simulation gives orders; the simulation has no other operator.
const OPERATOR: HostId = HostId::operator(0);
