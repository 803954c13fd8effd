//! Summary of a run: all episodes of a command such as `murmurate sim`, as JSON and as a table.

use std::fmt;

use serde::Serialize;
use xxhash_rust::xxh3::Xxh3;

use crate::event::Unwritten;
use crate::outcomes::{CostOutcomes, Outcomes};
use murmurate::config::shown::{self, counted};
use murmurate::net::media::radio::RadioCounts;
use murmurate::net::protocol::link::LinkCounts;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::results::episode::{AbortReason, Episode, Judged};
use murmurate::results::hardware::RobotHardware;
use murmurate::safety::guard::SafetyCounts;
use murmurate::scenario::judge::Verdict;
use murmurate::scenario::{Cost, Scenario, Settings};
use murmurate::time::Span;

/// Hosts that the counts in a summary of a run cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Counts {
    /// All hosts of the team.
    Team,
    /// Only the host that prints the summary: its published and undelivered messages, and the safety events of its
    /// robots. It does not know the counts of other hosts.
    Host,
}

/// Summary of a run, printed as a table or as JSON. Later versions may add fields and remove none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the deployment's mode.
    pub(crate) mode: String,
    pub(crate) scenario: String,
    pub(crate) policy: String,
    pub(crate) robots: usize,
    /// Counts of verdicts, success rate and makespan of all episodes.
    #[serde(flatten)]
    pub(crate) outcomes: Outcomes,
    /// Counts under the former names of the fields `robot_collisions`, `wall_collisions` and `aborted` of [`Outcomes`],
    /// kept for one version.
    #[serde(flatten)]
    former: FormerNames,
    /// Name and unit of the cost of episodes; left out in a scenario with goals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) cost: Option<CostName>,
    /// Data from which episodes were judged: true states of a simulation, or readings.
    pub(crate) judged: Judged,
    /// Hosts whose messages, links and safety events are counted.
    pub(crate) counts: Counts,
    /// Simulated time of all trials together \[s\]; the length of the run if it was in real time.
    pub(crate) virtual_s: f64,
    /// Wall-clock time of the run \[s\].
    pub(crate) wall_s: f64,
    pub(crate) failed: Vec<FailedEpisode>,
    /// Description of the emulated links: delay, loss and radio; null if they are ideal or not emulated.
    pub(crate) network: Option<String>,
    /// Descriptions of the injected faults.
    pub(crate) faults: Vec<String>,
    /// Number of messages that the actors of the counted hosts published.
    pub(crate) messages: u64,
    /// Number of messages that were dropped because the mailbox of the receiving actor was full.
    pub(crate) refused: u64,
    /// Number of messages that were lost in crashes of actors.
    pub(crate) lost: u64,
    /// Numbers of datagrams sent, accepted, and refused by cause, on all links together.
    pub(crate) links: LinkCounts,
    /// Frames and airtime of all emulated radio channels together, and losses by cause; null without an emulated radio.
    pub(crate) radio: Option<RadioCounts>,
    /// Numbers of times that robots' guards stopped them or reduced their velocities, by cause.
    pub(crate) safety: SafetyCounts,
    /// Hardware of each real robot: last battery charge and temperature, number of hardware faults and the last one.
    pub(crate) hardware: Vec<RobotHardware>,
    /// Amounts of output (log lines, events, steps) that were dropped, as the control thread does not wait until output
    /// is written.
    pub(crate) unwritten: Unwritten,
    /// Largest age that a velocity command had while it still moved a robot \[s\]; null if it is unknown, as on real
    /// robots.
    pub(crate) oldest_command_s: Option<f64>,
    /// Trace: digest of every message and true state of the run, in hexadecimal; null for a run that was interrupted or
    /// in real time.
    pub(crate) trace_hash: Option<String>,
    /// Seed of the run.
    pub(crate) seed: u64,
    /// Whether a user interrupted the run before its end.
    pub interrupted: bool,
}

/// Name and unit of the cost of a scenario without goals.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CostName {
    /// Name of the cost, such as `velocity variance`.
    pub(crate) name: String,
    /// Unit of the cost, such as `m2/s2`.
    pub(crate) unit: String,
}

impl CostName {
    /// Returns name and unit of the cost of the scenario called `scenario`, for a team of `robots` robots; `None` for a
    /// scenario with goals, and if the registry cannot make it.
    pub fn named(registry: &Registry, scenario: &str, robots: usize) -> Option<CostName> {
        CostName::of(&*registry.scenario(scenario, &Settings::of(robots)).ok()?)
    }

    /// Returns name and unit of the cost of a scenario; `None` for a scenario with goals.
    pub fn of(scenario: &dyn Scenario) -> Option<CostName> {
        let Cost { name, unit, .. } = scenario.cost()?;
        Some(CostName { name: name.to_owned(), unit: unit.to_owned() })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct FailedEpisode {
    /// Index of the repeat, from 0.
    pub(crate) repeat: u32,
    /// Index of the episode in its repeat, from 0.
    pub(crate) episode: u32,
    /// Verdict on the episode.
    pub(crate) verdict: Verdict,
    /// Reason of an aborted episode, with its robot; left out for other verdicts, and if it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) reason: Option<AbortReason>,
}

/// Counts of collisions and aborted episodes under the former names of fields of [`Outcomes`], for scripts that still
/// read these names.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct FormerNames {
    collisions_robot: usize,
    collisions_wall: usize,
    aborts: usize,
}

/// Properties of a run that are not results, such as its mode, policy and seed; the input of [`Summary::of`].
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Name of the deployment's mode.
    pub mode: String,
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the policy.
    pub policy: String,
    /// Number of robots.
    pub robots: usize,
    /// Name and unit of the cost of episodes; `None` in a scenario with goals.
    pub cost: Option<CostName>,
    /// Data from which episodes are judged: true states of a simulation, or readings.
    pub judged: Judged,
    /// Seed of the run.
    pub seed: u64,
    /// Wall-clock time of the run \[s\].
    pub wall_s: f64,
    /// Description of the emulated links: delay, loss and radio; `None` if they are ideal or not emulated.
    pub network: Option<String>,
    /// Descriptions of the injected faults.
    pub faults: Vec<String>,
    /// Whether a user interrupted the run before its end.
    pub interrupted: bool,
}

/// Largest number of injected faults that the summary's table lists; its JSON has all.
const LISTED_FAULTS: usize = 4;
/// Largest number of failed episodes that the summary's table lists; its JSON has all.
const LISTED_FAILURES: usize = 6;
/// Largest number of aborted episodes whose reasons the summary's table lists; its JSON has all.
const LISTED_REASONS: usize = 4;

impl Summary {
    /// Summarizes a simulated run from the reports of its trials, which are in the order of their repeats.
    pub fn of(run: Run, trials: &[TrialReport]) -> Summary {
        let episodes: Vec<Episode> = trials.iter().flat_map(|trial| &trial.episodes).copied().collect();
        let outcomes = Outcomes::of(&episodes);
        let failures = episodes.iter().filter(|episode| episode.verdict.is_failure());
        let failed = failures.map(|&Episode { repeat, episode, verdict, reason, .. }| FailedEpisode {
            repeat,
            episode,
            verdict,
            reason,
        });
        let failed = failed.collect();
        let totals = || trials.iter().map(|trial| trial.totals);
        let mut trace = Xxh3::new();
        totals().for_each(|totals| trace.update(&totals.trace.to_le_bytes()));
        let Run { mode, scenario, policy, robots, cost, judged, seed, wall_s, network, faults, interrupted } = run;
        Summary {
            mode,
            scenario,
            policy,
            robots,
            former: FormerNames {
                collisions_robot: outcomes.robot_collisions,
                collisions_wall: outcomes.wall_collisions,
                aborts: outcomes.aborted,
            },
            outcomes,
            cost,
            judged,
            counts: Counts::Team,
            virtual_s: trials.iter().map(|trial| trial.simulated.as_secs()).sum(),
            wall_s,
            failed,
            network,
            faults,
            messages: totals().map(|totals| totals.messages).sum(),
            refused: trials.iter().map(|trial| trial.refused).sum(),
            lost: trials.iter().map(|trial| trial.lost).sum(),
            links: totals().map(|totals| totals.links).sum(),
            radio: Some(totals().map(|totals| totals.radio).sum()).filter(|radio: &RadioCounts| radio.channel_ns > 0),
            safety: totals().map(|totals| totals.safety).sum(),
            hardware: trials.iter().flat_map(|trial| &trial.hardware).cloned().collect(),
            unwritten: Unwritten::default(),
            oldest_command_s: totals().filter_map(|totals| totals.oldest_command).max().map(Span::as_secs),
            trace_hash: (!interrupted).then(|| format!("{:032x}", trace.digest128())),
            seed,
            interrupted,
        }
    }

    /// Summarizes a run in real time from `report`, the report of its only trial. `counts` tells which hosts the report
    /// counts; `unwritten` is the amount of dropped output. The summary has no trace.
    pub fn of_team(run: Run, report: TrialReport, counts: Counts, unwritten: Unwritten) -> Summary {
        // Runs in real time cannot be repeated exactly, so there is no trace to compare.
        Summary { counts, unwritten, trace_hash: None, ..Summary::of(run, &[report]) }
    }

    /// Writes the table's lines about costs and failures, in a scenario without goals.
    fn write_cost(&self, f: &mut fmt::Formatter<'_>, cost: &CostOutcomes) -> fmt::Result {
        let CostOutcomes { completed, cost_mean, cost_ci95: [low, high], cost_median } = cost;
        let unit = self.cost.as_ref().map_or("", |cost| cost.unit.as_str());
        let name = self.cost.as_ref().map_or("", |cost| cost.name.as_str());
        writeln!(f, "  cost         {cost_mean:>8.4}   mean {name} [{unit}] (95 %: {low:.4} to {high:.4})")?;
        writeln!(f, "  {:<12} {cost_median:>8.4}   median", "")?;
        let episodes = self.outcomes.episodes;
        writeln!(f, "  completed    {completed:>8}   of {}, without a failure", counted(episodes, "episode"))?;
        writeln!(f, "  failures     {:>8}   {}", episodes - completed, self.outcomes.failures())
    }

    /// Writes the table's lines about emulated links and injected faults.
    fn write_imposed(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(network) = &self.network {
            writeln!(f, "  network      {:>8}   {network}", "")?;
        }
        for (index, fault) in self.faults.iter().take(LISTED_FAULTS).enumerate() {
            let head = if index == 0 { self.faults.len().to_string() } else { String::new() };
            let name = if index == 0 { "faults" } else { "" };
            writeln!(f, "  {name:<12} {head:>8}   {fault}")?;
        }
        if let Some(more) = self.faults.len().checked_sub(LISTED_FAULTS).filter(|more| *more > 0) {
            writeln!(f, "  {:<12} {:>8}   and {more} more; --json has them all", "", "")?;
        }
        Ok(())
    }

    /// Writes the table's lines about messages that were not delivered, with the causes for which links refused them.
    fn write_undelivered(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let frames: u64 = self.links.losses().map(|(count, _)| count).sum();
        let (refused, lost) = (self.refused, self.lost);
        let undelivered = refused + lost + frames;
        if undelivered == 0 {
            return Ok(());
        }
        let by = format!("{refused} by full mailboxes, {lost} in crashes, {frames} refused by links");
        writeln!(f, "  undelivered  {undelivered:>8}   {by}")?;
        let causes: Vec<String> = self.links.losses().map(|(count, cause)| format!("{count} {cause}")).collect();
        if causes.is_empty() { Ok(()) } else { writeln!(f, "  {:<12} {:>8}   links: {}", "", "", causes.join(", ")) }
    }

    /// Returns the name of a failed episode, such as "episode 4 of repeat 1"; both count from 1.
    fn name(&self, failed: &FailedEpisode) -> String {
        let several = self.failed.iter().any(|failed| failed.repeat > 0);
        let of = if several { format!(" of repeat {}", failed.repeat + 1) } else { String::new() };
        format!("episode {}{of}", failed.episode + 1)
    }

    /// Writes the table's lines about failed episodes: their names, and the reasons of the first aborted ones.
    fn write_failed(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.failed.is_empty() {
            return Ok(());
        }
        writeln!(f, "  {:<12} {:>8}   {}", "", "in", self.failed_episodes())?;
        let aborted = self.failed.iter().filter_map(|failed| Some((failed, failed.reason?)));
        for (failed, reason) in aborted.take(LISTED_REASONS) {
            writeln!(f, "  {:<12} {:>8}   {}: {reason}", "", "aborted", self.name(failed))?;
        }
        Ok(())
    }

    /// Lists the first failed episodes as text, such as "episode 4 of repeat 1, episode 2 of repeat 3".
    fn failed_episodes(&self) -> String {
        let words = |failed: &FailedEpisode| self.name(failed);
        let listed = self.failed.iter().take(LISTED_FAILURES).map(words).collect::<Vec<_>>().join(", ");
        match self.failed.len().checked_sub(LISTED_FAILURES) {
            Some(more) if more > 0 => format!("{listed} and {more} more"),
            _ => listed,
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let Outcomes { episodes, successes, success_ci95: [low, high], .. } = self.outcomes;
        writeln!(
            f,
            "{}, scenario {}, mode {}, policy {}, seed {}",
            counted(self.robots, "robot"),
            shown::value(&self.scenario),
            shown::value(&self.mode),
            shown::value(&self.policy),
            self.seed
        )?;
        if self.interrupted {
            writeln!(f, "  interrupted: what follows counts the episodes until then")?;
        }
        if let Some(cost) = &self.outcomes.cost {
            self.write_cost(f, cost)?;
        } else {
            let share = percent(self.outcomes.success_rate);
            let (low, high) = (percent(low), percent(high));
            writeln!(f, "  success      {share:>8}   {successes} of {episodes} (95 %: {low} to {high})")?;
            match (self.outcomes.makespan_median_s, self.outcomes.makespan_quartiles_s) {
                (Some(median), Some([first, third])) => {
                    writeln!(f, "  makespan   {median:>8.2} s   median (quartiles {first:.2} and {third:.2} s)")?;
                }
                _ => writeln!(f, "  makespan            -   no episode succeeded")?,
            }
            writeln!(f, "  failures     {:>8}   {}", episodes - successes, self.outcomes.failures())?;
        }
        self.write_failed(f)?;
        self.write_imposed(f)?;
        if self.judged == Judged::Readings {
            writeln!(f, "  judged       readings   what touched between two readings of a robot was not seen")?;
        }
        let held: Vec<String> = self.safety.reasons().map(|(n, what)| format!("{n} {what}")).collect();
        if !held.is_empty() {
            let times: u64 = self.safety.reasons().map(|(n, _)| n).sum();
            writeln!(f, "  safety       {times:>8}   {}", held.join(", "))?;
        }
        for robot in &self.hardware {
            writeln!(f, "  robot        {:>8}   {}", robot.robot.0, robot.words())?;
        }
        let speed = self.virtual_s / self.wall_s.max(1e-9);
        writeln!(f, "  simulated  {:>8.0} s   in {:.2} s: {speed:.0} x real time", self.virtual_s, self.wall_s)?;
        if let Some(radio) = &self.radio {
            let causes: Vec<String> =
                radio.causes().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
            let lost = if causes.is_empty() { "none lost".to_owned() } else { format!("lost {}", causes.join(", ")) };
            let (airtime, wanted) = (percent(radio.airtime()), radio.wanted);
            writeln!(f, "  radio        {airtime:>8}   of airtime used; of {wanted} copies of frames {lost}")?;
        }
        self.write_undelivered(f)?;
        let Unwritten { log_lines, events, steps, record_events } = self.unwritten;
        if self.unwritten.total() > 0 {
            let lines = [(log_lines, "log line"), (events, "event"), (steps, "step")].map(|(n, noun)| counted(n, noun));
            let what = format!("{} of trajectories, {} of records", lines.join(", "), counted(record_events, "event"));
            writeln!(f, "  unwritten    {:>8}   {what}", self.unwritten.total())?;
        }
        if self.counts == Counts::Host {
            writeln!(f, "  counted by  this host   safety, undelivered and messages are not those of the other hosts")?;
        }
        let trace =
            self.trace_hash.as_deref().unwrap_or(if self.interrupted { "incomplete" } else { "none: real time" });
        write!(f, "  messages     {:>8}   trace {trace}", self.messages)
    }
}
