//! Properties of a policy file, and the parts of their table that are the same for both formats.

use serde::Serialize;

use murmurate::config::shown;
use murmurate::observation::{Frame, Request};
use murmurate::policy::Draw;
use murmurate::policy::hops::manifest::{Entry, Named};
use murmurate::policy::manifest::{Field, Training};
use murmurate::policy::probe::Difference;
use murmurate::policy::weights::Probe;

/// Properties of a policy file, which `policy check` prints. `M` is the type of the file's metadata.
#[derive(Serialize)]
pub struct Facts<'a, M> {
    /// Name of the file, or of the built-in policy.
    pub file: String,
    /// First 64 bits of the file's BLAKE3 hash, in hexadecimal.
    pub digest: &'a str,
    /// Manifest of the file: what it says of its network, such as shapes, period and training.
    pub manifest: &'a M,
    /// Number of weights and biases of all networks in the file.
    pub parameters: usize,
    /// Size of the latent in a robot's message \[bytes\].
    pub latent_bytes: usize,
    /// Differences of the networks' outputs from the correct outputs in the file (its probe); `None` if the file has no
    /// probe.
    pub probe: Option<ProbeFacts>,
    /// Warnings about the file, one line each.
    pub warnings: Vec<String>,
}

/// Largest differences between the outputs of the file's networks and the correct outputs in the file (its probe).
/// Differences from numbers above 1 are relative.
#[derive(Serialize)]
pub struct ProbeFacts {
    robots: usize,
    latent_difference: f32,
    output_difference: f32,
}

impl ProbeFacts {
    /// Returns the facts for the differences that the comparison with the probe has found.
    pub fn of(Difference { robots, latent, output }: Difference) -> ProbeFacts {
        ProbeFacts { robots, latent_difference: latent, output_difference: output }
    }
}

/// Returns a table as text, under a heading that says that this program can run the file `file`. `rows` has the name
/// and value of each row.
pub fn lines(file: &str, rows: &[(&str, String)]) -> String {
    let rows: Vec<String> = rows.iter().map(|(name, value)| format!("  {name:<14} {}", shown::value(value))).collect();
    format!("{}: this program can run it\n{}", shown::value(file), rows.join("\n"))
}

/// Returns the names as a list separated by commas, or `none`.
pub fn list(names: Vec<&str>) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Describes the entries of a policy's observation as text, with their units and frames.
pub fn observation(entries: &[Entry]) -> String {
    let name = |entry: &Entry| match entry {
        Entry::Field(Field::GoalMinusPosition) => "goal - position [m]".to_owned(),
        Entry::Field(Field::Position) => "position [m]".to_owned(),
        Entry::Field(Field::PositionPlusVelocity) => "position + velocity x 1 s [m]".to_owned(),
        Entry::Field(Field::Velocity) => "velocity [m/s]".to_owned(),
        Entry::Field(Field::FilterAndLag) => {
            "safety filter on (1) or off (0), and lag of the drivetrain [s]".to_owned()
        }
        Entry::Channel(Named { name, observed }) => channel(&observed.request(name)),
    };
    let names: Vec<String> = entries.iter().map(name).collect();
    format!("{}; policy frame", list(names.iter().map(String::as_str).collect()))
}

/// Describes as text a channel that a policy takes, with its shape, unit and frame.
pub fn channel(request: &Request) -> String {
    let frame = request.frame.map_or(String::new(), |frame| format!(", {}", in_frame(frame)));
    let of = if request.channel == request.input { String::new() } else { format!(" = {}", request.channel) };
    format!("{}{of} {:?} [{}{frame}]", request.input, request.shape, request.unit)
}

/// Returns the name of a frame in texts.
pub fn in_frame(frame: Frame) -> &'static str {
    match frame {
        Frame::Policy => "policy frame",
        Frame::World => "world frame",
        Frame::Body => "body frame",
    }
}

/// Describes as text what a policy keeps from one step to the next.
pub fn state(state: Option<(usize, f64)>) -> String {
    state.map_or("none".to_owned(), |(floats, after_gap_s)| {
        format!("{floats} floats, from zeros at each episode and after a gap of {after_gap_s} s")
    })
}

/// Describes as text how actions are taken from their distribution: its mean, or samples.
pub fn drawn(draw: Draw) -> &'static str {
    match draw {
        Draw::Mean => "the mean of its distribution",
        Draw::Sample => "sampled from its distribution",
    }
}

/// Describes as text how far the networks' outputs differ from the correct outputs in the file (its probe).
pub fn probe<M>(facts: &Facts<M>) -> String {
    facts.probe.as_ref().map_or("none in the file".to_owned(), |probe| {
        format!(
            "{}: latents within {:.1e}, outputs within {:.1e} (accepted: {:.0e})",
            shown::counted(probe.robots, "robot"),
            probe.latent_difference,
            probe.output_difference,
            Probe::TOLERANCE
        )
    })
}

/// Describes as text the training that made a policy file: program, preset, seed and number of decisions.
pub fn made(training: Option<&Training>) -> String {
    training.map_or("not stated".to_owned(), |made| {
        format!(
            "{}, preset {}, seed {}, {}",
            made.program,
            made.preset,
            made.seed,
            shown::counted(made.decisions, "decision")
        )
    })
}
