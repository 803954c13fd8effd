//! Tasks, channels and kinds of policies of the benchmark as data, and the cells that there are of them.

use std::collections::BTreeSet;

use murmurate::net::media::radio::Topology;

/// Kinds of policies that every task is asked for: scripted, trained on messages that all arrive, and trained on
/// messages that are late or lost.
pub const KINDS: [&str; 3] = ["scripted", "without", "trained"];

/// Reason why a task has no policy of the kind `without`.
const NO_PAIR: &str = "no weights that were trained on perfect messages are shipped for this task";

/// Task of the benchmark.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    /// Name of the task in the benchmark.
    pub name: &'static str,
    /// Name of its scenario in the registry of the program.
    pub scenario: &'static str,
    /// Number of robots where the channel does not say one.
    pub robots: usize,
    /// Least and largest number of robots; fewer than the least would not hear each other.
    pub sizes: [usize; 2],
    /// Radius within which its policies use messages \[m\].
    pub radius_m: f64,
    /// Number of episodes of a cell without `--episodes`: fewer where an episode takes long.
    pub episodes: u32,
    /// Flags of `sim`, without `--`, and their values, that hold in every cell.
    pub settings: &'static [(&'static str, &'static str)],
    /// Policy of each of [`KINDS`] as `sim --policy` takes it, or the reason why there is none.
    pub policies: [Result<&'static str, &'static str>; 3],
}

/// Robots that act at moments of their own, with the safety functions of real hosts and hulls of 0.16 m.
const DEPLOYED: &[(&str, &str)] =
    &[("mode", "onboard-adhoc"), ("contacts", "judge"), ("wall-radius-m", "0.16"), ("safety", "deployed")];
/// The same without the safety filter, whose stops cost more than what is measured.
const OPEN: &[(&str, &str)] = &[("mode", "onboard-adhoc"), ("safety", "emulated")];

/// Tasks of the benchmark, in the order of its tables.
pub static TASKS: [Task; 6] = [
    Task {
        name: "passage",
        scenario: "passage",
        robots: 5,
        sizes: [2, 12],
        radius_m: 2.0,
        episodes: 200,
        settings: DEPLOYED,
        policies: [Ok("orca"), Ok("published"), Ok("shipped")],
    },
    Task {
        name: "swap",
        scenario: "swap",
        robots: 8,
        sizes: [2, 20],
        radius_m: 2.0,
        episodes: 200,
        settings: DEPLOYED,
        policies: [Ok("orca"), Err(NO_PAIR), Ok("shipped")],
    },
    Task {
        name: "navigation",
        scenario: "navigation",
        robots: 8,
        sizes: [2, 12],
        radius_m: 2.0,
        episodes: 100,
        settings: DEPLOYED,
        policies: [Ok("orca"), Err(NO_PAIR), Ok("shipped")],
    },
    Task {
        name: "rooms",
        scenario: "four-rooms",
        robots: 6,
        sizes: [2, 12],
        radius_m: 2.0,
        episodes: 100,
        settings: DEPLOYED,
        policies: [Ok("orca"), Err(NO_PAIR), Ok("shipped")],
    },
    Task {
        name: "coverage",
        scenario: "coverage",
        robots: 32,
        sizes: [20, 64],
        radius_m: 128.0,
        episodes: 12,
        settings: OPEN,
        policies: [Ok("coverage-cvt"), Err(NO_PAIR), Ok("shipped")],
    },
    Task {
        name: "flocking",
        scenario: "flocking",
        robots: 50,
        sizes: [20, 100],
        radius_m: 2.0,
        episodes: 40,
        settings: OPEN,
        policies: [Ok("flock-local"), Err(NO_PAIR), Ok("shipped")],
    },
];

/// Way of messages between robots on a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Air {
    /// Every message arrives at once.
    Perfect,
    /// Each receiver loses each message with this probability, independently.
    Iid {
        /// Probability, 0 to 1.
        loss: f64,
    },
    /// All messages are lost for a share of the time: times of silence and times between them are exponential.
    Bursts {
        /// Share of the time, 0 to 1.
        share: f64,
        /// Mean duration of a silence \[s\].
        mean_s: f64,
    },
    /// Every message arrives late.
    Delay {
        /// Delay \[ms\].
        ms: f64,
    },
    /// A channel of 802.11, multicast at 1 Mbit/s, on which all stations sense each other.
    Wifi {
        /// Messages of each robot \[1/s\].
        rate_hz: u32,
        /// Bytes of headers of each frame, with what makes a frame as long as several.
        overhead_bytes: u32,
    },
    /// A channel of 802.11, multicast at 1 Mbit/s, with ranges.
    Space {
        /// Range of reading, as a multiple of the radius of the task's policies.
        reads: f64,
        /// Range of sensing, as a multiple of the range of reading.
        senses: f64,
        /// Whether the link is a mesh, so that stops cross hops.
        mesh: bool,
    },
}

/// Channel of the benchmark.
#[derive(Clone, Copy, Debug)]
pub struct Channel {
    /// Name of the channel.
    pub name: &'static str,
    /// Description in one line.
    pub about: &'static str,
    /// Number of robots; `None` for the task's own.
    pub robots: Option<usize>,
    /// Way of the messages.
    pub air: Air,
}

const fn of_team(name: &'static str, about: &'static str, air: Air) -> Channel {
    Channel { name, about, robots: None, air }
}

const fn wifi(name: &'static str, robots: usize, rate_hz: u32, overhead_bytes: u32) -> Channel {
    let about = match (rate_hz, overhead_bytes) {
        (10, _) => "802.11 at 1 Mbit/s, 10 messages a robot and second",
        (_, HEADERS) => "802.11 at 1 Mbit/s, 20 messages a robot and second",
        _ => "802.11 at 1 Mbit/s, 20 messages a robot and second, each as long as three",
    };
    Channel { name, about, robots: Some(robots), air: Air::Wifi { rate_hz, overhead_bytes } }
}

/// Bytes of the headers of a frame, as in the radio `wifi`.
const HEADERS: u32 = 66;
/// Bytes of overhead with which a frame of 223 bytes, that of most trained policies here, is as long as three.
const OF_THREE: u32 = HEADERS + 2 * 223;

/// Name of the channel against which a policy's result on every other one is held.
pub const REFERENCE: &str = "perfect";

/// Channels of the benchmark, in the order of its tables; the first is [`REFERENCE`].
pub static CHANNELS: [Channel; 19] = [
    of_team(REFERENCE, "every message arrives at once", Air::Perfect),
    of_team("iid-5", "5 % of the messages are lost, independently", Air::Iid { loss: 0.05 }),
    of_team("iid-30", "30 % of the messages are lost, independently", Air::Iid { loss: 0.3 }),
    of_team(
        "bursts",
        "all messages are lost for 30 % of the time, 0.5 s in the mean",
        Air::Bursts { share: 0.3, mean_s: 0.5 },
    ),
    of_team("delay", "messages arrive 100 ms late", Air::Delay { ms: 100.0 }),
    of_team(
        "hidden",
        "802.11 at 1 Mbit/s, read up to 1.25 radii of the policy and sensed no further",
        Air::Space { reads: 1.25, senses: 1.0, mesh: false },
    ),
    of_team(
        "mesh",
        "802.11 at 1 Mbit/s, read up to 0.6 radii of the policy, sensed up to 1.8 times as far, mesh = true",
        Air::Space { reads: 0.6, senses: 1.8, mesh: true },
    ),
    wifi("wifi-3-10", 3, 10, HEADERS),
    wifi("wifi-3-20", 3, 20, HEADERS),
    wifi("wifi-3-60", 3, 20, OF_THREE),
    wifi("wifi-5-10", 5, 10, HEADERS),
    wifi("wifi-5-20", 5, 20, HEADERS),
    wifi("wifi-5-60", 5, 20, OF_THREE),
    wifi("wifi-10-10", 10, 10, HEADERS),
    wifi("wifi-10-20", 10, 20, HEADERS),
    wifi("wifi-10-60", 10, 20, OF_THREE),
    wifi("wifi-20-10", 20, 10, HEADERS),
    wifi("wifi-20-20", 20, 20, HEADERS),
    wifi("wifi-20-60", 20, 20, OF_THREE),
];

/// Combinations that there are of a benchmark's tasks and channels: a task, a channel and a number of robots.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Task of the cell.
    pub task: &'static Task,
    /// Channel of the cell.
    pub channel: &'static Channel,
    /// Number of robots.
    pub robots: usize,
}

/// Place in the matrix that is empty.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Empty {
    /// Name of the task.
    pub task: String,
    /// Name of the channel; `None` if all of the task's are meant.
    pub channel: Option<String>,
    /// Kind of policy; `None` if all are meant.
    pub policy: Option<String>,
    /// Reason why there is no result.
    pub why: String,
}

impl Cell {
    /// Returns the flags of `sim`, without `--`, and the fields of its files, with their values, that make the cell.
    pub fn settings(&self) -> Vec<(String, String)> {
        let mut all = vec![setting("scenario", self.task.scenario), setting("robots", self.robots)];
        all.extend(self.task.settings.iter().map(|(name, value)| setting(name, value)));
        let field = |name: &str, value: &dyn ToString| setting(&format!("{LATENTS}.{name}"), value.to_string());
        let channel = serde_json::to_value(Topology::AdHoc).expect("a name");
        let ad_hoc = field("radio.channel", &channel.as_str().unwrap_or_default());
        match self.channel.air {
            Air::Perfect | Air::Bursts { .. } => {}
            Air::Iid { loss } => all.push(setting("loss", loss)),
            Air::Delay { ms } => all.push(setting("delay-ms", ms)),
            Air::Wifi { rate_hz, overhead_bytes } => {
                all.extend([ad_hoc, field("radio.overhead_bytes", &overhead_bytes), setting("latent-rate-hz", rate_hz)])
            }
            Air::Space { reads, senses, mesh } => all.extend([
                ad_hoc,
                field("radio.range_m", &format!("{:?}", reads * self.task.radius_m)),
                field("radio.sense_m", &format!("{:?}", senses * reads * self.task.radius_m)),
                field("mesh", &mesh),
            ]),
        }
        all
    }
}

/// Link of the deployments of all tasks that carries latents, as a field of the file.
const LATENTS: &str = "deployment.link.0";

fn setting(name: &str, value: impl ToString) -> (String, String) {
    (name.to_owned(), value.to_string())
}

/// Returns the cells of these tasks and channels, and the places that are empty. For each number of robots of a task
/// there is a cell on [`REFERENCE`], also if that is not among the channels.
pub fn cells(tasks: &[&'static Task], channels: &[&'static Channel]) -> (Vec<Cell>, Vec<Empty>) {
    let (mut cells, mut empty) = (Vec::new(), Vec::new());
    for &task in tasks {
        let mut wanted: BTreeSet<(usize, usize)> = BTreeSet::new();
        for channel in channels {
            let robots = channel.robots.unwrap_or(task.robots);
            let [least, most] = task.sizes;
            if !(least..=most).contains(&robots) {
                let why = format!("here the task is for {least} to {most} robots");
                let channel = Some(channel.name.to_owned());
                empty.push(Empty { task: task.name.to_owned(), channel, policy: None, why });
                continue;
            }
            let at = CHANNELS.iter().position(|other| other.name == channel.name).expect("a channel of the benchmark");
            wanted.extend([(0, robots), (at, robots)]);
        }
        cells.extend(wanted.into_iter().map(|(at, robots)| Cell { task, channel: &CHANNELS[at], robots }));
        for (kind, policy) in KINDS.iter().zip(task.policies) {
            if let Err(why) = policy {
                let (task, policy) = (task.name.to_owned(), Some((*kind).to_owned()));
                empty.push(Empty { task, channel: None, policy, why: why.to_owned() });
            }
        }
    }
    (cells, empty)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_every_cell_has_a_reference_with_its_number_of_robots() {
        let tasks: Vec<&'static Task> = TASKS.iter().collect();
        let channels: Vec<&'static Channel> = CHANNELS.iter().collect();
        let names: BTreeSet<&str> = tasks.iter().map(|task| task.name).collect();
        assert_eq!(names.len(), TASKS.len());
        assert_eq!(channels.iter().map(|channel| channel.name).collect::<BTreeSet<_>>().len(), CHANNELS.len());
        let (cells, empty) = cells(&tasks, &channels);
        let places: BTreeSet<_> = cells.iter().map(|cell| (cell.task.name, cell.channel.name, cell.robots)).collect();
        assert_eq!(places.len(), cells.len(), "no cell is there twice");
        assert!(cells.iter().all(|cell| places.contains(&(cell.task.name, REFERENCE, cell.robots))));
        // Each task and channel has a cell or says why not.
        for task in &tasks {
            for channel in &channels {
                let is = |cell: &Cell| cell.task.name == task.name && cell.channel.name == channel.name;
                let said = |empty: &Empty| empty.task == task.name && empty.channel.as_deref() == Some(channel.name);
                assert!(cells.iter().any(is) != empty.iter().any(said), "{} on {}", task.name, channel.name);
            }
        }
    }

    #[test]
    fn a_reference_is_added_for_the_robots_of_a_channel() {
        let channel = CHANNELS.iter().find(|channel| channel.name == "wifi-3-20").expect("a channel");
        let (cells, empty) = cells(&[&TASKS[0], &TASKS[5]], &[channel]);
        let places: Vec<_> = cells.iter().map(|cell| (cell.task.name, cell.channel.name, cell.robots)).collect();
        assert_eq!(places, [("passage", REFERENCE, 3), ("passage", "wifi-3-20", 3)]);
        assert_eq!(empty[0].why, "here the task is for 20 to 100 robots");
        let (name, value) = ("latent-rate-hz".to_owned(), "20".to_owned());
        assert!(cells[1].settings().contains(&(name, value)));
    }
}
