//! Fit of a radio to measured or published rows of a network study. The parameters are noise loss, background load and
//! data rate.
//!
//! The emulation is run with candidate parameters and compared with every value of a row: shares within 20 and 50 ms,
//! share delivered, median and 90 % delay. The search starts on a grid over all rates and refines the best points. Its
//! seed differs from that of the rows, so that agreement is not by chance. In the end each residual is weighted by the
//! variation of its value over seeds: near saturation a delay is less informative than a share far from it.

use serde::Deserialize;

use super::case::{Addressing, Case, NetworkKind, ReliabilityMode, Source, Sweep};
use super::medium::Medium;
use super::outcome::{Outcome, Row};
use murmurate::net::media::radio::rate::{self, Rate};
use murmurate::net::media::radio::{Radio, Topology};

/// Observed values of one case of a network study, to which a radio is fitted. Values that were not observed are
/// `None`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Observed {
    #[serde(default)]
    source: Option<Source>,
    addressing: Addressing,
    reliability: ReliabilityMode,
    retries: u32,
    network: NetworkKind,
    rate: f64,
    /// Duration of the case's measurement \[s\]; `None` for the duration in the sweep.
    #[serde(default)]
    seconds: Option<f64>,
    #[serde(default)]
    delivered: Option<f64>,
    #[serde(default)]
    within_20ms: Option<f64>,
    #[serde(default)]
    within_50ms: Option<f64>,
    #[serde(default)]
    p50_ms: Option<f64>,
    #[serde(default)]
    p90_ms: Option<f64>,
}

/// Result of a fit of a radio's parameters to rows of a network study.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// Radio with the fitted parameters.
    pub radio: Radio,
    /// Root mean square of the residuals of all shares of deliveries (delivered, within 20 ms, within 50 ms).
    pub shares: f64,
    /// Root mean square of the residuals of the logarithms of all delays (median and 90 % quantile).
    pub delays: f64,
    /// Other data rates of the radio with which it fits almost as well as with the fitted one; the rows do not
    /// distinguish them.
    pub alternatives: Vec<Rate>,
    /// Each observed row, with the row that the emulation gives for the same case and the fitted radio.
    pub rows: Vec<(Observed, Row)>,
}

/// Function that runs cases of a network study, in any order and on any number of threads. It returns their outcomes in
/// the order of the cases, and `None` for each interrupted case.
pub type Runner<'a> = &'a dyn Fn(&[(Sweep, Case)]) -> Vec<Option<Outcome>>;

/// Residuals of one row of a network study: of three shares of deliveries (delivered, within 20 ms, within 50 ms), and
/// of the logarithms of two delays (median, 90 %). `None` for a value that was not observed.
type Residuals = [Option<f64>; 5];
/// Tolerance of each of a row's five residuals (three shares, two logarithms of delays) before its variation over
/// seeds is known, and the lower limit of its tolerance afterwards.
const TOLERANCES: [f64; 5] = [0.03, 0.03, 0.03, 0.15, 0.15];
const LEAST_TOLERANCES: [f64; 5] = [0.005, 0.005, 0.005, 0.02, 0.02];
/// Number of seeds from which the variation of each residual is estimated.
const SEEDS: u64 = 5;
/// Limits of compared delays \[ms\]: the shortest, up to which all delays count as equal, and the value that stands
/// for no delivery.
const DELAYS_MS: (f64, f64) = (0.05, 1e4);
/// Probabilities of loss by noise on the grid from which the fit's search starts.
const NOISES: [f64; 5] = [0.0, 0.06, 0.12, 0.2, 0.35];
const BACKGROUNDS: [f64; 5] = [0.0, 0.15, 0.3, 0.45, 0.6];
/// Effort of the search's first stage, the grid: largest number of rows and longest emulated duration \[s\]. The
/// later stages refine the grid's best points, and the best of those. The last stage runs as long as the rows were
/// observed, up to a minute, because queues and delays of a saturated channel keep growing.
const COARSE: (usize, f64) = (16, 4.0);
const MIDDLE: (usize, f64) = (16, 10.0);
const FINE: (usize, f64) = (64, 60.0);
/// Delay of a row from which on a growing queue is assumed \[ms\]. The delays of such a row are not compared with a
/// run shorter than the observation.
const GROWING_MS: f64 = 50.0;
/// Number of data rates whose best grid point is refined in the second stage. Fewer are refined again in the last
/// one: those with a misfit of at most a multiple of the best plus a constant.
const STARTS: usize = 10;
const BEST: usize = 4;
const NEAR_BEST: (f64, f64) = (3.0, 3.0);
/// Multiple of the best misfit below which another data rate counts as fitting almost as well (an alternative).
const ALTERNATIVE: f64 = 2.0;
/// Initial steps of the pattern search in noise loss and in background load.
const STEPS: (f64, f64) = (0.04, 0.08);
const HALVINGS: u32 = 3;

/// Candidate parameters of the radio.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    rate: Rate,
    noise: f64,
    background: f64,
}

struct Fit<'a> {
    base: &'a Radio,
    sweep: &'a Sweep,
    observed: &'a [Observed],
    runner: Runner<'a>,
    /// For each row: tolerance of each residual (three shares, two logarithms of delays), by which it is divided.
    tolerances: Vec<[f64; 5]>,
}

/// Fits noise loss, background load and data rate of the radio `base` to the observed rows. `sweep` has the number of
/// stations, message size and RTPS history of the rows' study. Returns `None` if `runner` was interrupted.
///
/// # Panics
/// If `observed` is empty.
pub fn fit(base: &Radio, sweep: &Sweep, observed: &[Observed], runner: Runner) -> Option<Fitted> {
    assert!(!observed.is_empty(), "a fit needs rows");
    let mut fit = Fit { base, sweep, observed, runner, tolerances: vec![TOLERANCES; observed.len()] };
    let mut grid = Vec::new();
    // The two generations have rates of almost the same speed, which the rows cannot distinguish.
    let own = family(base.rate);
    for rate in rate::all().filter(|rate| rate.fits(base.width_mhz) && (fit.only_multicast() || family(*rate) == own)) {
        for noise in NOISES {
            grid.extend(BACKGROUNDS.map(|background| Point { rate, noise, background }));
        }
    }
    let sorted = |mut found: Vec<(f64, Point)>| {
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found
    };
    let mut refined: Vec<(f64, Point)> = Vec::new();
    for (_, point) in sorted(fit.misfits(&grid, COARSE)?.into_iter().zip(grid).collect()) {
        if refined.len() < STARTS && !refined.iter().any(|(_, other)| other.rate == point.rate) {
            refined.push(fit.refine(point, MIDDLE, STEPS)?);
        }
    }
    let refined = sorted(refined);
    fit.tolerances = fit.spread(refined[0].1)?;
    let mut best: Vec<(f64, Point)> = Vec::new();
    let near = NEAR_BEST.0 * refined[0].0 + NEAR_BEST.1;
    for (_, point) in refined.into_iter().take(BEST).take_while(|(misfit, _)| *misfit <= near) {
        let scale = f64::from(1 << (HALVINGS - 1));
        best.push(fit.refine(point, FINE, (STEPS.0 / scale, STEPS.1 / scale))?);
    }
    let best = sorted(best);
    let alternatives = best[1..].iter().filter(|(misfit, _)| *misfit < ALTERNATIVE * best[0].0);
    fit.result(best[0].1, alternatives.map(|(_, point)| point.rate).collect())
}

/// Returns the generation of 802.11 of a rate, which is the first part of its name.
fn family(rate: Rate) -> String {
    rate.to_string().split('-').next().unwrap_or_default().to_owned()
}

impl Fit<'_> {
    /// Returns whether only multicast frames occur in all rows.
    fn only_multicast(&self) -> bool {
        self.observed.iter().all(|observed| {
            (observed.addressing, observed.network) == (Addressing::Multicast, NetworkKind::AdHoc)
                && !matches!(observed.reliability, ReliabilityMode::Ack | ReliabilityMode::AckOff)
        })
    }

    /// Returns the radio with the parameters of a point. The point's rate is the multicast rate if all rows are
    /// multicast, otherwise the unicast rate.
    fn radio(&self, point: Point) -> Radio {
        let Point { rate, noise, background } = point;
        let mut radio = Radio { noise_loss: noise, background, ..self.base.clone() };
        if self.only_multicast() {
            radio.basic_rate = rate
        } else {
            radio.rate = rate
        }
        radio
    }

    fn runs(&self, point: Point, effort: (usize, f64)) -> Vec<(Sweep, Case)> {
        self.runs_of(0, point, effort)
    }

    /// Returns the indices of at most `rows` of the observed rows. They are chosen by a hash of the index, so that
    /// they are spread evenly.
    fn selected(&self, rows: usize) -> Vec<usize> {
        let all = self.observed.len();
        let mut order: Vec<usize> = (0..all).collect();
        order.sort_by_key(|at| (*at as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        order.truncate(rows);
        order.sort_unstable();
        order
    }

    fn runs_of(&self, number: u64, point: Point, (rows, longest): (usize, f64)) -> Vec<(Sweep, Case)> {
        let medium = Medium::Radio(self.radio(point));
        let seed = self.sweep.seed.wrapping_add(0x5eed + number);
        let run = |at: usize| {
            let observed = &self.observed[at];
            let seconds = observed.seconds.unwrap_or(self.sweep.seconds).min(longest);
            (Sweep { medium: medium.clone(), seconds, seed, ..self.sweep.clone() }, observed.case())
        };
        self.selected(rows).into_iter().map(run).collect()
    }

    /// Emulates the rows with the radio parameters of each point, and returns each point's misfit: the sum of its
    /// weighted residuals. `None` if the emulation was interrupted.
    fn misfits(&self, points: &[Point], effort: (usize, f64)) -> Option<Vec<f64>> {
        let runs: Vec<(Sweep, Case)> = points.iter().flat_map(|point| self.runs(*point, effort)).collect();
        let each = runs.len() / points.len();
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let selected = self.selected(effort.0);
        let misfit = |outcomes: &[Outcome]| {
            let terms = selected.iter().zip(outcomes).flat_map(|(&at, outcome)| {
                let residuals = self.observed[at].comparable_to(outcome.seconds).residuals(outcome);
                residuals
                    .into_iter()
                    .zip(&self.tolerances[at])
                    .filter_map(|(residual, tolerance)| Some(residual? / tolerance))
            });
            // A robust loss: the logarithm limits the influence of outliers.
            terms.map(|term| (term * term).ln_1p()).sum()
        };
        Some(outcomes.chunks(each).map(misfit).collect())
    }

    /// Returns the tolerances of each row's residuals, from their variation over seeds at a point. `None` if the
    /// emulation was interrupted.
    fn spread(&self, point: Point) -> Option<Vec<[f64; 5]>> {
        let all = (self.observed.len(), FINE.1);
        let runs: Vec<(Sweep, Case)> = (1..=SEEDS).flat_map(|number| self.runs_of(number, point, all)).collect();
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let of_row = |(at, observed): (usize, &Observed)| {
            let seeds: Vec<Residuals> = outcomes
                .iter()
                .skip(at)
                .step_by(all.0)
                .map(|outcome| observed.comparable_to(outcome.seconds).residuals(outcome))
                .collect();
            std::array::from_fn(|figure| {
                let values: Vec<f64> = seeds.iter().filter_map(|figures| figures[figure]).collect();
                let mean = values.iter().sum::<f64>() / SEEDS as f64;
                let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64;
                LEAST_TOLERANCES[figure].hypot(2.0 * variance.sqrt())
            })
        };
        Some(self.observed.iter().enumerate().map(of_row).collect())
    }

    /// Minimizes the misfit by pattern search from a point, with its data rate fixed. Returns the least misfit and
    /// its point; `None` if the emulation was interrupted.
    fn refine(&self, from: Point, effort: (usize, f64), mut steps: (f64, f64)) -> Option<(f64, Point)> {
        let mut best = (self.misfits(&[from], effort)?[0], from);
        for _ in 0..HALVINGS {
            loop {
                let around = |&(noise, background): &(f64, f64)| Point {
                    noise: (best.1.noise + noise * steps.0).clamp(0.0, 1.0),
                    background: (best.1.background + background * steps.1).clamp(0.0, 1.0),
                    ..best.1
                };
                let ways = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, -1.0), (-1.0, 1.0)];
                let points: Vec<Point> = ways.iter().map(around).filter(|point| *point != best.1).collect();
                let misfits = self.misfits(&points, effort)?;
                let found = misfits.into_iter().zip(points).min_by(|a, b| a.0.total_cmp(&b.0)).expect("there are ways");
                if found.0 >= best.0 {
                    break;
                }
                best = found;
            }
            steps = (steps.0 / 2.0, steps.1 / 2.0);
        }
        let (misfit, Point { rate, noise, background }) = best;
        tracing::info!("misfit {misfit:.2} at {rate}, noise loss {noise:.3}, background {background:.3}");
        Some(best)
    }

    fn result(&self, point: Point, alternatives: Vec<Rate>) -> Option<Fitted> {
        let runs = self.runs(point, (self.observed.len(), FINE.1));
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let rows: Vec<(Observed, Row)> = self
            .observed
            .iter()
            .zip(&outcomes)
            .map(|(observed, outcome)| (observed.clone(), observed.row(outcome)))
            .collect();
        let rms = |figures: std::ops::Range<usize>| {
            let pairs = self.observed.iter().zip(&outcomes);
            let all: Vec<f64> = pairs
                .flat_map(|(observed, outcome)| {
                    observed.comparable_to(outcome.seconds).residuals(outcome)[figures.clone()].to_vec()
                })
                .flatten()
                .collect();
            (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt()
        };
        Some(Fitted { radio: self.radio(point), shares: rms(0..3), delays: rms(3..5), alternatives, rows })
    }
}

impl Observed {
    /// Returns the observed row's case: network, addressing, reliability mode, retry limit and message rate.
    pub fn case(&self) -> Case {
        let Observed { network, addressing, reliability, retries, rate, .. } = *self;
        Case { network, addressing, reliability, retries, rate }
    }

    /// Returns the values that can be compared with a run of `seconds` \[s\]. Delays of a growing queue are left out if
    /// the run is shorter than the observation.
    fn comparable_to(&self, seconds: f64) -> Observed {
        let mut known = self.clone();
        let shorter = self.seconds.is_some_and(|observed| seconds < 0.99 * observed);
        if shorter && self.p90_ms.or(self.p50_ms).is_some_and(|delay_ms| delay_ms > GROWING_MS) {
            (known.p50_ms, known.p90_ms) = (None, None);
        }
        known
    }

    fn row(&self, outcome: &Outcome) -> Row {
        Row::of(Source::Emulated, &self.case(), outcome)
    }

    /// Returns the residuals of this observed row against the outcome of a run: differences of shares, and of
    /// logarithms of delays.
    fn residuals(&self, outcome: &Outcome) -> Residuals {
        let row = self.row(outcome);
        let share = |seen: Option<f64>, emulated: f64| Some(seen? - emulated);
        let delay = |seen: Option<f64>, emulated: Option<f64>| {
            let (least, none) = DELAYS_MS;
            Some((seen?.max(least) / emulated.unwrap_or(none).max(least)).ln())
        };
        [
            share(self.delivered, row.delivered),
            share(self.within_20ms, row.within_20ms),
            share(self.within_50ms, row.within_50ms),
            delay(self.p50_ms, row.p50_ms),
            delay(self.p90_ms, row.p90_ms),
        ]
    }

    /// Returns whether the row was measured between hosts; `false` if it was emulated or has no source.
    pub fn is_live(&self) -> bool {
        self.source == Some(Source::Live)
    }

    /// Checks that the observed row can belong to the network study `sweep` and that a radio can be fitted to it. The
    /// error is a text that says what is wrong.
    pub fn check(&self, sweep: &Sweep) -> Result<(), String> {
        let seconds = self.seconds.unwrap_or(sweep.seconds);
        let (rates, retries) = (vec![self.rate], vec![self.retries]);
        Sweep { rates, retries, seconds, ..sweep.clone() }.check().map_err(|error| error.to_string())?;
        let share = |value: &Option<f64>| value.is_none_or(|value| (0.0..=1.0).contains(&value));
        let delay = |value: &Option<f64>| value.is_none_or(|value| value > 0.0 && value.is_finite());
        let figures = [self.delivered, self.within_20ms, self.within_50ms, self.p50_ms, self.p90_ms];
        if self.network == NetworkKind::Shaped {
            Err("it is of shaped links, and only a radio can be fitted".to_owned())
        } else if !figures[..3].iter().all(share) || !figures[3..].iter().all(delay) {
            Err("a share is not 0 to 1, or a delay is not a positive number".to_owned())
        } else if figures.iter().all(Option::is_none) {
            Err("it has none of delivered, within_20ms, within_50ms, p50_ms and p90_ms".to_owned())
        } else {
            Ok(())
        }
    }
}

impl From<&Row> for Observed {
    fn from(row: &Row) -> Observed {
        let Case { network, addressing, reliability, retries, rate } = row.case();
        Observed {
            source: Some(row.source),
            addressing,
            reliability,
            retries,
            network,
            rate,
            seconds: Some(row.seconds),
            delivered: Some(row.delivered),
            within_20ms: Some(row.within_20ms),
            within_50ms: Some(row.within_50ms),
            p50_ms: row.p50_ms,
            p90_ms: row.p90_ms,
        }
    }
}

impl Fitted {
    /// Returns the fitted radio as the text of a TOML file. A comment in it says what it was fitted to and gives
    /// `command`, the command of the fit.
    pub fn to_toml(&self, command: &str) -> String {
        let mut radio = self.radio.clone();
        let adhoc = self.rows.iter().all(|(observed, _)| observed.network == NetworkKind::AdHoc);
        radio.channel = if adhoc { Topology::AdHoc } else { Topology::Infrastructure };
        format!(
            "# A radio fitted to {} rows of a network study: noise_loss, background and rate.\n\
             # Residuals between rows and emulation, root mean square: {:.1} points of the shares, {:.0} % of \
             the delays.\n# {command}\n\n{}",
            self.rows.len(),
            100.0 * self.shares,
            100.0 * (self.delays.exp() - 1.0),
            toml::to_string(&radio).expect("a radio is TOML")
        )
    }
}
