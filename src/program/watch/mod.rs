//! The live page of a command: its flags, its server and its feed.

mod feed;
pub mod team;
#[cfg(feature = "sim")]
pub mod trial;

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow};

use crate::messages::ids::HostId;
use crate::program::bad;
use crate::program::key;
use crate::program::output::talk;
use crate::view::access::{Access, Control, TOKEN_BYTES, Token};
use crate::view::server::{Publisher, Server};
use crate::view::status::Scene;

/// Flags of a page.
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
}

/// Flags of a command that serves a page when it is asked to.
#[derive(clap::Args)]
pub struct OptionalPage {
    /// Serves a page that shows the team while it runs, and prints its address (docs/watch.md)
    #[arg(long)]
    pub watch: bool,
    #[command(flatten)]
    pub page: PageFlags,
}

impl OptionalPage {
    /// Fails if a flag of the page is given without `--watch`.
    pub fn check(&self) -> Result<()> {
        let PageFlags { listen, control, token_file } = &self.page;
        let given = [("--listen", listen.is_some()), ("--control", *control), ("--token-file", token_file.is_some())];
        match given.iter().find(|(_, given)| *given && !self.watch) {
            Some((flag, _)) => bad(format!("{flag}: there is no page; add --watch")),
            None => Ok(()),
        }
    }
}

impl PageFlags {
    /// Opens the server of the page and prints its address. `most` are the commands that the process can execute.
    pub fn open(&self, mut scene: Scene, most: Control) -> Result<(Server, Publisher)> {
        let listen = self.listen.unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], 0)));
        let guarded = !listen.ip().to_canonical().is_loopback();
        if guarded && self.token_file.is_none() {
            return bad(format!(
                "--listen: other machines reach {listen}, so the page needs a token: make one with 'murmurate key new \
                 --out page.token' and give --token-file page.token, or keep 127.0.0.1 and use an ssh tunnel"
            ));
        }
        let token = match &self.token_file {
            Some(file) => Token::new(&key::read(file)?),
            None => {
                let mut bytes = [0; TOKEN_BYTES];
                getrandom::fill(&mut bytes).map_err(|e| anyhow!("the operating system gives no random bytes: {e}"))?;
                Token::new(&bytes)
            }
        };
        let control = if self.control { most } else { Control::StopOnly };
        scene.control = match control {
            Control::StopOnly => "stop",
            Control::Team => "team",
            Control::Emulation => "emulation",
        };
        // A token from a file is not printed.
        let secret = match &self.token_file {
            Some(file) => format!("#TOKEN, with the token that is in {}", file.display()),
            None if self.control => format!("#{}", token.digits()),
            None => String::new(),
        };
        let opened = Server::open(listen, Access { token, control, guarded }, scene.to_json());
        let (server, publisher) = opened.with_context(|| format!("--listen: cannot serve the page at {listen}"))?;
        talk(&format!("watch: http://{}/{secret}", server.address()));
        Ok((server, publisher))
    }
}

/// Operator id of the page in a run of one process, which has no other operator.
const OPERATOR: HostId = HostId::operator(0);
