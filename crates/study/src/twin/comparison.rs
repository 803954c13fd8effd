//! Comparison of a twin's prediction with the measured run: for each quantity both values with their intervals, and the
//! largest difference with which they still agree (its bar).

use std::fmt;

use serde::Serialize;

use super::ages::Decisions;
use super::estimate::{Estimate, binomial_95, bootstrap, smooth_quantile_of};
use super::links::FittedLink;
use super::model::Fitted;
use super::observed::Run;
use super::predict::Predicted;
use murmurate::random::{Seed, Stream};
use murmurate::results::episode::Episode;
use murmurate::scenario::judge::Verdict;
use murmurate_report::statistics::{quantile, wilson_95};

/// Bar of a compared quantity: the largest difference of measurement and prediction with which they agree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bar {
    /// The measurement lies in the 95 % interval of the prediction.
    Interval,
    /// The difference is at most this share of the measurement.
    Share(f64),
    /// The difference is at most this number, in the row's unit.
    Difference(f64),
    /// There is no bar: the row is for information, and always agrees.
    Free,
}

/// Row of the comparison of a twin with its run: one quantity, as predicted and as measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the quantity.
    pub name: String,
    /// Unit of the quantity; empty if it has none.
    pub unit: &'static str,
    /// Predicted value, with the 95 % interval of a measurement of as many episodes as were predicted; for a parameter
    /// of the model the fitted value, with its own interval.
    pub predicted: Estimate,
    /// Value measured in the predicted episodes of the run, or for a parameter fitted to them, with its 95 % interval.
    pub measured: Estimate,
    /// Largest difference of prediction and measurement with which they agree.
    pub bar: Bar,
    /// Whether the difference of prediction and measurement is within the bar.
    pub agrees: bool,
}

/// Largest difference of the predicted median makespan from the measured one, as a share of the latter.
const MAKESPAN: f64 = 0.05;
/// Largest difference of a predicted quantile of message ages from the measured one, as a share of the latter.
const AGE: f64 = 0.10;
/// Largest difference \[s\] between the drivetrain lags found on the fitted and on the predicted episodes.
const LAG_S: f64 = 0.05;
const DELAY_MS: f64 = 2.0;
const LOSS_POINTS: f64 = 2.0;

impl Row {
    fn new(name: &str, unit: &'static str, both: (Estimate, Estimate), bar: Bar) -> Row {
        let (predicted, measured) = both;
        let off = (predicted.value - measured.value).abs();
        let agrees = match bar {
            Bar::Interval => (predicted.ci95[0]..=predicted.ci95[1]).contains(&measured.value),
            Bar::Share(share) => off <= share * measured.value.abs(),
            Bar::Difference(most) => off <= most,
            Bar::Free => true,
        };
        Row { name: name.to_owned(), unit, predicted, measured, bar, agrees }
    }
}

/// Returns the rows of the comparison of a twin with its recorded run. Of `run`, the episodes from `first` on were
/// predicted; `predicted` has one entry for each simulated repeat. `fitted` is the model that made the prediction,
/// `later` the model that the same fit finds on the predicted episodes. `links` are the names of the links; `seed`
/// seeds the bootstrap of the intervals. Without predictions, only the parameters of the two models are compared.
pub fn rows(
    run: &Run,
    first: usize,
    predicted: &[Predicted],
    (fitted, later): (&Fitted, &Fitted),
    (links, seed): (&[String], u64),
) -> Vec<Row> {
    let seed = Seed::of_run(seed).child("twin");
    // An imported run has neither.
    let episodes = run.episodes.get(first..).unwrap_or_default();
    let decisions = run.decisions.get(first..).unwrap_or_default();
    let mut rows = Vec::new();
    if !predicted.is_empty() {
        rows.push(success(episodes, predicted));
    }
    let mut stream = seed.stream("makespan");
    let makespan = |episodes: &[&Episode]| {
        let all: Vec<f64> = episodes.iter().filter_map(|episode| episode.makespan_s).collect();
        quantile(&all, 0.5)
    };
    let pair = over(
        predicted.iter().map(|one| one.episodes.iter().collect()).collect(),
        episodes.iter().collect(),
        &mut stream,
        makespan,
    );
    rows.extend(pair.map(|pair| Row::new("makespan, median", "s", pair, Bar::Share(MAKESPAN))));
    for (name, q, bar) in [
        ("message age, 10 %", 0.1, Bar::Free),
        ("message age, median", 0.5, Bar::Share(AGE)),
        ("message age, 90 %", 0.9, Bar::Share(AGE)),
    ] {
        let all = |of: &[&Decisions]| of.iter().flat_map(|one| one.ages_s.iter().copied()).collect();
        // If ticks keep their offsets, ages have few different values.
        let age = |of: &[&Decisions]| smooth_quantile_of(all(of), q);
        let pair = ages(predicted, decisions, &mut seed.stream(name), age);
        rows.extend(pair.map(|(one, other)| Row::new(name, "ms", (one.scaled(1e3), other.scaled(1e3)), bar)));
    }
    let used = |of: &[&Decisions]| {
        let messages: usize = of.iter().map(|one| one.ages_s.len()).sum();
        let steps: usize = of.iter().map(|one| one.count).sum();
        (messages > 0).then(|| messages as f64 / steps as f64)
    };
    let pair = ages(predicted, decisions, &mut seed.stream("used"), used);
    rows.extend(pair.map(|pair| Row::new("messages in use", "", pair, Bar::Free)));
    rows.extend(model(fitted, later, links));
    rows
}

fn success(episodes: &[Episode], predicted: &[Predicted]) -> Row {
    let count = |episodes: &[Episode]| episodes.iter().filter(|one| one.verdict == Verdict::Success).count();
    let simulated: usize = predicted.iter().map(|one| one.episodes.len()).sum();
    let successes: usize = predicted.iter().map(|one| count(&one.episodes)).sum();
    // Jeffreys' mean: even if no simulated episode failed, the predicted rate is below 1.
    let share = (successes as f64 + 0.5) / (simulated as f64 + 1.0);
    let percent = |part: f64| 100.0 * part;
    let ends = binomial_95(episodes.len(), share).map(|end| percent(end as f64 / episodes.len().max(1) as f64));
    let value = percent(successes as f64 / simulated.max(1) as f64);
    let measured = count(episodes);
    let measured = Estimate {
        value: percent(measured as f64 / episodes.len().max(1) as f64),
        ci95: wilson_95(measured, episodes.len()).map(percent),
    };
    Row::new("success", "%", (Estimate { value, ci95: ends }, measured), Bar::Interval)
}

/// Estimates a statistic of the messages in use at decisions, such as a quantile of their ages: over the decisions of
/// all simulated repeats, and over those of the measured episodes, each with its 95 % interval. `None` if either side
/// has no data. `stream` gives the random numbers of the bootstrap.
fn ages(
    predicted: &[Predicted],
    measured: &[Decisions],
    stream: &mut Stream,
    statistic: impl Fn(&[&Decisions]) -> Option<f64>,
) -> Option<(Estimate, Estimate)> {
    over(
        predicted.iter().map(|one| one.decisions.iter().collect()).collect(),
        measured.iter().collect(),
        stream,
        statistic,
    )
}

/// Estimates a statistic of episodes, such as the median makespan, for prediction and measurement. The first estimate
/// is over all simulated repeats, with the 95 % interval of its values in single repeats; the second is over the
/// measured episodes, with a bootstrap interval.
fn over<T>(
    repeats: Vec<Vec<&T>>,
    measured: Vec<&T>,
    stream: &mut Stream,
    statistic: impl Fn(&[&T]) -> Option<f64>,
) -> Option<(Estimate, Estimate)> {
    let single: Vec<f64> = repeats.iter().filter_map(|repeat| statistic(repeat)).collect();
    let value = statistic(&repeats.concat())?;
    let predicted = Estimate { value, ci95: [quantile(&single, 0.025)?, quantile(&single, 0.975)?] };
    let measured = bootstrap(measured.len(), stream, |drawn| {
        let drawn: Vec<&T> = drawn.iter().map(|at| measured[*at]).collect();
        statistic(&drawn)
    })?;
    Some((predicted, measured))
}

/// Returns the rows that compare the parameters of the fitted model (lag, slip, delay and loss of links) with those
/// that the same fit finds on the predicted episodes. `links` are the names of the links.
fn model(fitted: &Fitted, later: &Fitted, links: &[String]) -> Vec<Row> {
    let mut rows = Vec::new();
    let both = fitted.lag_s.zip(later.lag_s);
    rows.extend(both.map(|pair| Row::new("drivetrain lag", "s", pair, Bar::Difference(LAG_S))));
    let both = fitted.slip.zip(later.slip);
    let slip = both.map(|(one, other)| (one.share.scaled(100.0), other.share.scaled(100.0)));
    rows.extend(slip.map(|pair| Row::new("slip", "%", pair, Bar::Free)));
    let names = links.iter().map(|name| format!("link {name}"));
    let each = names.zip(fitted.links.iter().zip(&later.links));
    let all = ("all links".to_owned(), (&fitted.all_links, &later.all_links));
    for (name, (one, other)) in each.chain([all]) {
        let (Some(one), Some(other)) = (one, other) else { continue };
        let delay = one.delay_s.zip(other.delay_s).map(|(one, other)| (one.scaled(1e3), other.scaled(1e3)));
        rows.extend(delay.map(|pair| Row::new(&format!("{name}, delay"), "ms", pair, Bar::Difference(DELAY_MS))));
        let loss = one.loss.zip(other.loss).map(|(one, other)| (one.scaled(100.0), other.scaled(100.0)));
        rows.extend(loss.map(|pair| Row::new(&format!("{name}, loss"), "%", pair, Bar::Difference(LOSS_POINTS))));
    }
    if let Some((one, other)) = fitted.path.zip(later.path) {
        rows.push(Row::new("path loss, exponent", "", (one.exponent, other.exponent), Bar::Free));
        rows.push(Row::new("path loss, 37 % arrive over", "m", (one.reach_m, other.reach_m), Bar::Free));
    }
    // An emulated link has a constant delay, so the prediction does not contain the variation of delays.
    let slowest = |link: FittedLink| link.spread_s.map(|[_, slow_s]| Estimate::exact(1e3 * slow_s));
    let both = fitted.all_links.and_then(slowest).zip(later.all_links.and_then(slowest));
    rows.extend(both.map(|pair| Row::new("all links, delay, 95 %", "ms", pair, Bar::Free)));
    rows
}

impl fmt::Display for Bar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Bar::Interval => write!(f, "in the interval"),
            Bar::Share(share) => write!(f, "within {:.0} %", 100.0 * share),
            Bar::Difference(most) => write!(f, "within {most}"),
            Bar::Free => write!(f, "no bar"),
        }
    }
}

impl Row {
    /// Heads of the columns of the table that compares a twin with its run.
    pub const HEADS: [&str; 6] = ["", "predicted", "95 %", "measured", "95 %", "bar"];

    /// Returns the row's cells as text, in the order of the heads `HEADS`.
    pub fn cells(&self) -> [String; 6] {
        let number = |value: f64| match value.abs() {
            size if size >= 10.0 => format!("{value:.1}"),
            size if size >= 1.0 => format!("{value:.2}"),
            _ => format!("{value:.3}"),
        };
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        let interval = |[low, high]: [f64; 2]| format!("{} to {}", number(low), number(high));
        let bar = if self.agrees { self.bar.to_string() } else { format!("OUTSIDE: {}", self.bar) };
        [
            self.name.clone(),
            number(self.predicted.value) + &unit,
            interval(self.predicted.ci95),
            number(self.measured.value) + &unit,
            interval(self.measured.ci95),
            bar,
        ]
    }
}

/// Returns the rows of a comparison as a table of text, with heads.
pub fn text(rows: &[Row]) -> String {
    let cells: Vec<[String; 6]> =
        [Row::HEADS.map(str::to_owned)].into_iter().chain(rows.iter().map(Row::cells)).collect();
    let width = |at: usize| cells.iter().map(|row| row[at].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..6).map(width).collect();
    let line = |row: &[String; 6]| {
        let mut line = format!("{:1$}", row[0], widths[0]);
        for at in 1..5 {
            line += &format!("  {:>1$}", row[at], widths[at]);
        }
        format!("{line}  {}", row[5]).trim_end().to_owned()
    };
    cells.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::results::episode::Judged;

    fn episodes(makespan_s: f64, failures: usize) -> Vec<Episode> {
        let episode = |episode: u32| {
            let failed = (episode as usize) < failures;
            let verdict = if failed { Verdict::Timeout } else { Verdict::Success };
            let makespan_s = (!failed).then_some(makespan_s + f64::from(episode) * 0.01);
            let judged = Judged::Truth;
            let (cost, reason) = (None, None);
            Episode {
                repeat: 0,
                episode,
                verdict,
                makespan_s,
                reset_s: 0.0,
                min_separation_m: 1.0,
                judged,
                cost,
                reason,
            }
        };
        (0..16).map(episode).collect()
    }

    fn decisions(age_s: f64) -> Vec<Decisions> {
        vec![Decisions { count: 10, ages_s: vec![age_s; 20] }; 16]
    }

    fn outside(makespan_s: f64, failures: usize, age_s: f64, lag_s: f64) -> Vec<String> {
        let both = |one: Vec<Episode>, other: Vec<Episode>| one.into_iter().chain(other).collect();
        let run = Run {
            episodes: both(episodes(9.0, 8), episodes(7.0, 1)),
            decisions: [decisions(0.5), decisions(0.05)].concat(),
            ..Run::default()
        };
        let one = Predicted { episodes: episodes(makespan_s, failures), decisions: decisions(age_s) };
        let lag = |lag_s| Fitted { lag_s: Some(Estimate::exact(lag_s)), ..Fitted::default() };
        let rows = rows(&run, 16, &[one.clone(), one], (&lag(lag_s), &lag(0.5)), (&[], 0));
        assert_eq!(text(&rows).lines().count(), rows.len() + 1);
        rows.into_iter().filter(|row| !row.agrees).map(|row| row.name).collect()
    }

    #[test]
    fn a_prediction_within_its_bars_agrees_and_each_that_is_not_is_named() {
        assert_eq!(outside(7.2, 1, 0.052, 0.52), Vec::<String>::new());
        assert_eq!(outside(8.0, 1, 0.052, 0.52), ["makespan, median"]);
        assert_eq!(outside(7.0, 12, 0.052, 0.52), ["success"]);
        assert_eq!(outside(7.0, 1, 0.06, 0.52), ["message age, median", "message age, 90 %"]);
        assert_eq!(outside(7.0, 1, 0.05, 0.0), ["drivetrain lag"]);
    }
}
