//! Flags of `murmurate sim` that define its trials; `study sweep` varies them.

use std::path::PathBuf;
use std::sync::OnceLock;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use murmurate::deploy::Stepping;
use murmurate::hearing::Handling;
use murmurate::policy::Draw;
use murmurate::safety::{Clamp, Safety};
use murmurate::scenario::layout::Layouts;
use murmurate::world::{ContactRule, Placement, Sensor};
use murmurate_robot::output::read_text;

use super::changes::Changes;
use crate::deployment::{self, ModeParser};
use crate::drive::DriveFlags;
use crate::size::SizeFlags;

/// Flags that define the trials of `sim`.
#[derive(clap::Args)]
pub struct Setup {
    /// Mode of the paper, which sets what each host runs
    #[arg(long, default_value = "sim", value_parser = ModeParser)]
    pub mode: String,
    /// Deployment file, which replaces --mode (see 'murmurate deployment')
    #[arg(long, value_name = "FILE.toml", conflicts_with = "mode")]
    pub deployment: Option<PathBuf>,
    /// Task of the team: a name, or a task file (docs/tasks.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "passage")]
    pub scenario: String,
    /// Policy of the robots: a name in the registry (shipped, robust, published, orca or another, also of your crate)
    /// or a policy file (safetensors). Several policies are compared on the same episodes [default: the better one of
    /// shipped and orca: shipped for passage and flocking]
    #[arg(long, value_name = "NAME|FILE")]
    pub policy: Vec<PathBuf>,
    /// Action of a trained policy: the mean of its distribution or a sample from it [default: as its file says]
    #[arg(long, value_parser = choice([("mean", Draw::Mean), ("sample", Draw::Sample)]))]
    pub action: Option<Draw>,
    /// Size of the team [default: that of the deployment file, or else the scenario's own]
    #[arg(long)]
    pub robots: Option<usize>,
    /// Width of the scenario's bottleneck [m] [default: that of the deployment file, or else the scenario's own]
    #[arg(long)]
    pub gap_m: Option<f32>,
    #[command(flatten)]
    pub size: SizeFlags,
    /// Number of episodes of a trial, each with its own layout (starts and goals) and a reset before it [default: those
    /// of --episodes-file, or else 200, or 16 with --watch, which shows them in real time]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub episodes: Option<u32>,
    /// Number of episodes that the episodes file has, once it is known.
    #[arg(skip)]
    held_episodes: OnceLock<Option<u32>>,
    /// Number of trials: the same layouts with other random numbers
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub repeats: Option<u32>,
    /// File with starts and goals: {"episodes": [[{"start": [x, y], "goal": [x, y]}, ...], ...]}
    #[arg(long, value_name = "FILE.json")]
    pub episodes_file: Option<PathBuf>,
    /// Placement of robots at their starts: put there exactly, or driven there [default: as the deployment says]
    #[arg(long, value_parser = choice([("exact", Placement::Exact), ("drive", Placement::Drive)]))]
    pub placement: Option<Placement>,
    /// Plant: the dynamics of simulated robots (docs/world.md) [default: as the deployment says, or else kinematic]
    #[arg(long)]
    pub plant: Option<String>,
    /// Time constant of simulated robots' drivetrains: the lag of their true velocity behind commands [s] [default:
    /// that of the plant: kinematic 0, rigid 0.5]
    #[arg(long)]
    pub lag_s: Option<f32>,
    /// Effect of a contact: 'block' does not make the move, as in training; 'judge' makes it and reports the contact to
    /// the judge [default: block; not for plant rigid]
    #[arg(long, value_parser = choice([("block", ContactRule::Block), ("judge", ContactRule::Judge)]))]
    pub contacts: Option<ContactRule>,
    /// Distance from a wall at which a robot's centre touches it [m] [default: the scenario's robot radius, 0.25; not
    /// for plant rigid]
    #[arg(long)]
    pub wall_radius_m: Option<f32>,
    /// Sensor of robots' states: exact, or with noise and latency [default: that of the plant: kinematic exact, rigid
    /// motion-capture]
    #[arg(long, value_parser = choice(Sensor::NAMED))]
    pub sensor: Option<Sensor>,
    /// Limit of acceleration: 'training' is a limit of the world, 1 m/s^2; 'deployed' is only that of the robots'
    /// controllers, commands within 0.25 m/s of the measured velocity, as on the published robots
    #[arg(long, default_value = "training",
        value_parser = choice([("training", Clamp::Training), ("deployed", Clamp::Deployed)]))]
    pub clamp: Clamp,
    /// Safety functions between policy and motor commands: 'emulated' are those of the published robots; 'deployed' are
    /// those of real hosts, with stops on late ticks and stale state, a geofence and a minimum distance; 'filter' is
    /// the safety filter (docs/safety.md) [default: emulated in lock step, the conditions of training, as in mode
    /// 'sim'; else deployed]
    #[arg(long, value_parser = choice([("emulated", Safety::emulated()), ("deployed", Safety::deployed()),
        ("filter", Safety::filter())]))]
    pub safety: Option<Safety>,
    /// Handling of a neighbour's message after the step that used it: 'as-published' drops it; 'hold' keeps it until a
    /// newer one arrives or the policy's hold time is over
    #[arg(long, default_value = "hold",
        value_parser = choice([("as-published", Handling::AsPublished), ("hold", Handling::Hold)]))]
    pub handling: Handling,
    /// Time that a step of the policy takes [ms]; one that takes more than half of its period is late, and its robots
    /// stand, as on real hosts
    #[arg(long, default_value_t = 0.0)]
    pub step_ms: f64,
    /// Estimator of a robot's state between its readings
    #[arg(long, default_value = "none")]
    pub estimator: String,
    /// Senses of the robots, such as a lidar: a file with the tables [senses.NAME] of a team file (docs/senses.md)
    #[arg(long, value_name = "FILE.toml")]
    pub senses: Option<PathBuf>,
    /// Roles of the robots, with a policy, a radius, a drive or senses of their own: a file with the tables
    /// [roles.NAME] of a team file (docs/roles.md)
    #[arg(long, value_name = "FILE.toml")]
    pub roles: Option<PathBuf>,
    /// Delay of a message on a link [ms]
    #[arg(long, default_value_t = 0.0)]
    pub delay_ms: f64,
    /// Share of messages that a receiver loses, 0 to 1
    #[arg(long, default_value_t = 0.0)]
    pub loss: f64,
    /// Messages that --delay-ms and --loss act on: latents, or all on every link but cables [default: latent]
    #[arg(long, value_parser = PossibleValuesParser::new(["latent", "all"]))]
    pub impair: Option<String>,
    /// Radio of the links: 'none' (ideal links, or those of the deployment file), a preset (PRESETS), or a radio file
    /// (docs/radio.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    pub radio: String,
    /// World, and delay and loss of messages between robots, such as 'study twin' fits them (docs/twin.md); other flags
    /// count before it
    #[arg(long, value_name = "FILE.toml")]
    pub conditions: Option<PathBuf>,
    /// Transmission range of the links that carry latents [m]: with one, a large team is simulated much faster;
    /// docs/simulate.md says by how much it should exceed the communication range [default: unlimited]
    #[arg(long)]
    pub link_range_m: Option<f32>,
    /// Rate at which a robot broadcasts its latent [Hz], 0.1 to 1000, at most once in a control step [default: as the
    /// deployment file says, or else in every step]
    #[arg(long)]
    pub latent_rate_hz: Option<f64>,
    /// Communication range of a robot [m], 'inf' for unlimited [default: as the policy's file says]
    #[arg(long)]
    pub comm_range_m: Option<f32>,
    /// Standard deviation of the communication range, which is drawn anew for every message [m]
    #[arg(long, default_value_t = 0.0)]
    pub comm_range_std_m: f32,
    /// Fault plan: a seed to draw it from, or a file (docs/faults.md)
    #[arg(long, value_name = "SEED|FILE.toml")]
    pub faults: Option<String>,
    /// Chassis of the robots.
    #[command(flatten)]
    pub drive: DriveFlags,
    /// Changes of fields in the files of the flags, which a sweep makes.
    #[arg(skip)]
    pub changes: Changes,
}

impl Setup {
    /// Returns the number of episodes of a trial; `usual` without a flag and without an episodes file.
    pub fn episodes(&self, usual: u32) -> u32 {
        // A file that cannot be read is reported where its layouts are.
        let text = || self.episodes_file.as_deref().and_then(|path| read_text(path, "episodes file").ok());
        let held = || *self.held_episodes.get_or_init(|| text().as_deref().and_then(Layouts::held_in));
        self.episodes.or_else(held).unwrap_or(usual)
    }

    /// Returns the number of trials.
    pub fn repeats(&self) -> u32 {
        self.repeats.unwrap_or(1)
    }

    /// Returns the paths of the files that the flags may name, policies of roles left out; a name in the registry may
    /// be among them.
    pub fn files(&self) -> Vec<PathBuf> {
        let named = [&self.deployment, &self.episodes_file, &self.conditions, &self.senses, &self.roles];
        let texts = self.faults.iter().chain([&self.radio, &self.scenario]).map(PathBuf::from);
        named.into_iter().flatten().cloned().chain(self.policy.iter().cloned()).chain(texts).collect()
    }

    /// Returns the conditions of the network in words; `None` if it is ideal.
    pub fn network(&self) -> Option<String> {
        let all = self.impair.as_deref() == Some("all");
        let given = deployment::conditions(self.delay_ms, self.loss, all, &self.radio);
        let rate = self.latent_rate_hz.map(|rate_hz| format!("{rate_hz} latents a second"));
        let parts: Vec<String> = given.into_iter().chain(rate).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }

    /// Returns the safety functions of a trial whose agents act by the rule `stepping`.
    pub fn safety(&self, stepping: Stepping) -> Safety {
        self.safety.unwrap_or(match stepping {
            Stepping::Lockstep => Safety::emulated(),
            Stepping::Seeded => Safety::deployed(),
        })
    }
}

/// Returns the parser of a flag whose value is one of the names in `all`, with the value beside the name.
fn choice<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [(&'static str, T); N],
) -> impl TypedValueParser<Value = T> {
    let named = move |name: String| all.iter().find(|(other, _)| *other == name).map(|(_, value)| *value);
    PossibleValuesParser::new(all.map(|(name, _)| name))
        .map(move |name| named(name).expect("the parser lets only these names through"))
}
