//! Flags of commands that take a team file, and loading of the file, its key and its policy.

use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use murmurate::config::ConfigError;
use murmurate::deploy::Routes;
use murmurate::deploy::team::{Flag, Team, TeamFile};
use murmurate::graph::end::{HostEnd, Keep};
use murmurate::graph::operator::Operator;
use murmurate::live::links::{self, ProcessIdentity};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::registry::Registry;
use murmurate::scenario::Scenario;

use crate::BadInput;
use crate::bad;
use crate::key::{self, KeyFile};
use crate::output::{read_text, talk};
use crate::own_name;
use crate::policy;

/// Team file, and flags that override its fields.
#[derive(Clone, clap::Args)]
pub struct TeamArgs {
    /// Team file (docs/teams.md)
    #[arg(value_name = "TEAM.toml")]
    pub file: PathBuf,
    /// Sets a field of the team file, such as link.infra.interface=wlan1, or policy=NAME|FILE: a name in the registry
    /// (shipped, robust, published, orca or another, also of your crate) or a policy file (safetensors); may be given
    /// several times
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Network interface of every link
    #[arg(long, value_name = "NAME")]
    pub interface: Option<String>,
    /// File with the team's key
    #[arg(long, value_name = "FILE")]
    pub key_file: Option<PathBuf>,
}

/// Flags that select one host of the team.
#[derive(clap::Args)]
#[group(id = "which-host", multiple = false)]
pub struct Which {
    /// Selects the host by its name
    #[arg(long, value_name = "NAME")]
    host: Option<String>,
    /// Selects the host that runs this robot's agent
    #[arg(long, value_name = "N")]
    robot: Option<u16>,
}

impl TeamArgs {
    /// Returns these flags for a command in which another flag, such as `--live`, names the team file `file`. `set` has
    /// overrides of the file's fields, as `FIELD=VALUE`.
    pub fn of(file: PathBuf, set: Vec<String>) -> TeamArgs {
        TeamArgs { file, set, interface: None, key_file: None }
    }

    /// Sets the network interface of the link `link` on all hosts.
    pub fn set_interface(&mut self, link: &str, interface: &str) {
        self.set.push(format!("link.{link}.interface={interface}"));
    }

    /// Returns the path of the team file.
    pub fn path(&self) -> &Path {
        &self.file
    }

    /// Reads the team file, and overrides its fields by environment variables and flags. The registry has the parts
    /// (scenarios, policies and so on) that it may name. An error names file and field.
    pub fn read(&self, registry: &Registry) -> Result<TeamFile> {
        let variables: Vec<(String, String)> = std::env::vars_os()
            .map(|(name, value)| (name.to_string_lossy().into_owned(), value.to_string_lossy().into_owned()))
            .filter(|(name, _)| name.starts_with("MURMURATE_"))
            .collect();
        self.read_as_of(registry, None, &variables)
    }

    /// Reads the team file as another process has read it: with that process's environment variables `variables`, and
    /// with relative paths of the file that start from `folder` (`None` for the file's own folder).
    pub fn read_as_of(
        &self,
        registry: &Registry,
        folder: Option<&Path>,
        variables: &[(String, String)],
    ) -> Result<TeamFile> {
        let text = read_text(&self.file, "team file")?;
        let mut flags = Vec::new();
        for given in &self.set {
            let Some((key, value)) = given.split_once('=') else {
                return bad(format!("--set {given}: write FIELD=VALUE, such as --set seed=3"));
            };
            flags.push(Flag { flag: "--set", key: key.trim().to_owned(), value: value.trim().to_owned() });
        }
        let interface = self.interface.clone().map(|value| ("--interface", "interface", value));
        let key_file = self.key_file.as_ref().map(|path| ("--key-file", "key_file", path.to_string_lossy().into()));
        flags.extend([interface, key_file].into_iter().flatten().map(|(flag, key, value)| Flag {
            flag,
            key: key.to_owned(),
            value,
        }));
        let folder = folder.or(self.file.parent()).unwrap_or(Path::new(""));
        TeamFile::read(registry, &text, folder, variables, &flags).map_err(|e| self.wrong(&e))
    }

    /// Returns the error `error` of the team file as one that also names the file's path.
    pub fn wrong(&self, error: &ConfigError) -> anyhow::Error {
        BadInput(format!("the team file '{}': {error}", self.file.display())).into()
    }

    /// Opens the link that carries the team's emergency stop, and returns this process as an operator on it: a host
    /// without robots that may give orders. No other link is opened.
    pub fn operator(&self, file: &TeamFile) -> Result<Operator> {
        self.operator_as(file, ProcessIdentity::draw()?)
    }

    /// Opens the link that carries the team's emergency stop, and returns this process as an operator on it, with the
    /// process identity `identity`. No other link is opened.
    pub fn operator_as(&self, file: &TeamFile, mut identity: ProcessIdentity) -> Result<Operator> {
        let access = file.operator_access().map_err(|error| self.wrong(&error))?;
        let deployment = file.deployment();
        let file = key_of(access.key_file.as_deref())?;
        let keep = file.as_ref().and_then(keep_of);
        let key = file.map(|file| file.operator_key(access.number, &mut identity)).transpose()?;
        let key = key.map(|key| key.confidential_if(access.confidential));
        let me = identity.operator_of(access.number);
        let link = &deployment.links[usize::from(access.link.0)];
        Ok(Operator {
            end: HostEnd {
                me,
                key,
                seed: identity.seed,
                links: links::of_operator(deployment, links::places_of(&access, deployment)),
                keep,
                transports: links::join(&access, link, me.host, self.interface.is_some())?,
            },
            robots: deployment.robots,
            publishers: Routes::of(deployment).publishers(),
            stop: Some(access.link),
        })
    }

    /// Returns the team's configuration for the host `host`. An error names file and field.
    pub fn for_host(&self, file: &TeamFile, host: HostId) -> Result<Team> {
        file.for_host(host).map_err(|e| self.wrong(&e))
    }
}

impl Which {
    /// Returns the host that `--host` or `--robot` selects; `None` if neither is given. An error names the flag.
    pub fn find(&self, file: &TeamFile) -> Result<Option<HostId>> {
        let found = match (&self.host, self.robot) {
            (Some(name), _) => Some(file.host_named(name)),
            (None, Some(robot)) => Some(file.host_of(RobotId(robot))),
            (None, None) => None,
        };
        found.transpose().map_err(|e| BadInput(format!("--{e}")).into())
    }
}

/// Whether this process has already printed the warning that the team has no key.
static WARNED: AtomicBool = AtomicBool::new(false);

/// Makes this process print no warning about a team without a key, because the process that started it has printed one.
pub fn leave_out_key_warning() {
    WARNED.store(true, Ordering::Relaxed);
}

/// Reads the key of the team from its file. A team without a key gives `None`, and a warning if this host uses a link.
pub fn key(team: &Team) -> Result<Option<KeyFile>> {
    if team.key_file.is_none() && team.links.iter().all(Option::is_none) {
        return Ok(None);
    }
    let file = key_of(team.key_file.as_deref())?;
    if let Some(file) = &file {
        let name = &*team.deployment.hosts[usize::from(team.host.0)].name;
        file.check_host(team.number, (team.host, name))?;
    }
    Ok(file)
}

/// Reads the team's key from a file. If there is no file, prints a warning and returns `None`.
pub fn key_of(file: Option<&Path>) -> Result<Option<KeyFile>> {
    if file.is_none() && !WARNED.swap(true, Ordering::Relaxed) {
        talk(&format!(
            "warning: NO KEY: every program on this machine can command these robots; for anything but development \
             make a key with '{} key new' and name it as key_file",
            own_name()
        ));
    }
    file.map(key::read).transpose()
}

/// Returns the function by which an operator with this key file keeps rosters; `None` with the key of a whole team.
pub fn keep_of(file: &KeyFile) -> Option<Keep> {
    let kept = file.kept()?;
    Some(Rc::new(move |sealed: &[u8]| {
        kept.keep(sealed);
    }))
}

/// Returns the team's scenario, with the number of robots and the sizes of its deployment.
pub fn scenario(team: &Team, registry: &Registry) -> Result<Arc<dyn Scenario>> {
    Ok(team.make_scenario(registry).map_err(|e| BadInput(e.to_string()))?)
}

/// Loads the policies of the team's roles, and for all other robots the one that the team file names, or otherwise the
/// scenario's default policy; with warnings about their use by this team.
pub fn policy(team: &Team, registry: &Registry) -> Result<policy::LoadedTeam> {
    let scenario = scenario(team, registry)?;
    policy::load_team(registry, team.policy.as_deref(), None, (&team.deployment, &*scenario))
}
