//! Fits a radio to rows of a network study, measured or published: noise loss, background load and rate, nothing else.
//!
//! The emulation is run at candidate parameters and held against every figure that a row has: shares within a mark,
//! share delivered, median and 90 % delay. First on a grid over all rates, then finer around the best few. The seed
//! differs from that of the rows, so that nothing is recovered by chance. In the end each figure counts by how little
//! it varies from seed to seed: near saturation a delay says less than a share far from it.

use serde::Deserialize;

use super::case::{Addressing, Assurance, Case, Network, Source, Sweep};
use super::medium::Medium;
use super::outcome::{Outcome, Row};
use crate::net::media::radio::rate::{self, Rate};
use crate::net::media::radio::{Radio, Topology};

/// What is known of a case: the rows of a study, or less.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Observed {
    #[serde(default)]
    source: Option<Source>,
    addressing: Addressing,
    reliability: Assurance,
    retries: u32,
    network: Network,
    rate: f64,
    /// Where it is not known, as long as the sweep.
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

/// What came of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// The radio with the fitted parameters.
    pub radio: Radio,
    /// Root mean square of what is left between rows and emulation, over all shares.
    pub shares: f64,
    /// The same over the logarithms of delays.
    pub delays: f64,
    /// Other rates that fit almost as well: the rows do not tell them apart.
    pub rivals: Vec<Rate>,
    /// The rows, with the emulation at the fitted parameters beside.
    pub rows: Vec<(Observed, Row)>,
}

/// Runs cases, in any order and on any number of threads; `None` where it was told to stop.
pub type Runner<'a> = &'a dyn Fn(&[(Sweep, Case)]) -> Vec<Option<Outcome>>;

/// What a figure has: three shares, and the logarithms of two delays.
type Figures = [Option<f64>; 5];
/// By how much each must be off to count, at first; and at least, when it is known how much it varies.
const OFF: [f64; 5] = [0.03, 0.03, 0.03, 0.15, 0.15];
const LEAST_OFF: [f64; 5] = [0.005, 0.005, 0.005, 0.02, 0.02];
/// How many seeds tell how much a figure varies.
const SEEDS: u64 = 5;
/// No delay is told from a shorter one than this \[ms\]; and one that nothing has is so long.
const DELAYS_MS: (f64, f64) = (0.05, 1e4);
/// The grid.
const NOISES: [f64; 5] = [0.0, 0.06, 0.12, 0.2, 0.35];
const BACKGROUNDS: [f64; 5] = [0.0, 0.15, 0.3, 0.45, 0.6];
/// How many rows, for how long at the most, on the grid, around its best points and around the best of those \[s\]. In
/// the end for as long as they were observed, up to a minute: where a channel is full, queues and delays grow all the
/// while.
const COARSE: (usize, f64) = (16, 4.0);
const MIDDLE: (usize, f64) = (16, 10.0);
const FINE: (usize, f64) = (64, 60.0);
/// A delay from which a queue may have grown \[ms\]: of a shorter run it is not the measure.
const GROWS_MS: f64 = 50.0;
/// How many rates go on from the grid, each from its best point there, and how many go on from these: those that are
/// no more off than this many times the best, and this much.
const STARTS: usize = 10;
const BEST: usize = 4;
const NEAR_BEST: (f64, f64) = (3.0, 3.0);
/// A rate whose misfit is less than this many times the best fits almost as well.
const RIVAL: f64 = 2.0;
/// The first steps around them, of noise and background, and how often they are halved.
const STEPS: (f64, f64) = (0.04, 0.08);
const HALVINGS: u32 = 3;

/// A point that is tried.
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
    /// By row: how much its figures must be off to count.
    off: Vec<[f64; 5]>,
}

/// Fits `base` to what was observed with the stations, messages and history of `sweep`. `None` once the runner stops.
///
/// Panics if nothing was observed.
pub fn fit(base: &Radio, sweep: &Sweep, observed: &[Observed], runner: Runner) -> Option<Fitted> {
    assert!(!observed.is_empty(), "a fit needs rows");
    let mut fit = Fit { base, sweep, observed, runner, off: vec![OFF; observed.len()] };
    let mut grid = Vec::new();
    // Of another generation of 802.11 there is a rate as fast as almost any: rows cannot tell the two apart.
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
    fit.off = fit.spread(refined[0].1)?;
    let mut best: Vec<(f64, Point)> = Vec::new();
    let near = NEAR_BEST.0 * refined[0].0 + NEAR_BEST.1;
    for (_, point) in refined.into_iter().take(BEST).take_while(|(misfit, _)| *misfit <= near) {
        let scale = f64::from(1 << (HALVINGS - 1));
        best.push(fit.refine(point, FINE, (STEPS.0 / scale, STEPS.1 / scale))?);
    }
    let best = sorted(best);
    let rivals = best[1..].iter().filter(|(misfit, _)| *misfit < RIVAL * best[0].0);
    fit.result(best[0].1, rivals.map(|(_, point)| point.rate).collect())
}

/// The generation of 802.11 that a rate is of: the first part of its name.
fn family(rate: Rate) -> String {
    rate.to_string().split('-').next().unwrap_or_default().to_owned()
}

impl Fit<'_> {
    /// Whether nothing was ever sent by unicast.
    fn only_multicast(&self) -> bool {
        self.observed.iter().all(|observed| {
            (observed.addressing, observed.network) == (Addressing::Multicast, Network::AdHoc)
                && !matches!(observed.reliability, Assurance::Ack | Assurance::AckOff)
        })
    }

    /// Which rate of the radio the rows tell of: if nothing is ever unicast, the one of multicast.
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

    /// Which rows are taken, if there are more than so many: evenly, and whatever order rates and retries stand in.
    fn taken(&self, rows: usize) -> Vec<usize> {
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
        self.taken(rows).into_iter().map(run).collect()
    }

    /// How far each point is from what was observed.
    fn misfits(&self, points: &[Point], effort: (usize, f64)) -> Option<Vec<f64>> {
        let runs: Vec<(Sweep, Case)> = points.iter().flat_map(|point| self.runs(*point, effort)).collect();
        let each = runs.len() / points.len();
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let taken = self.taken(effort.0);
        let misfit = |outcomes: &[Outcome]| {
            let terms = taken.iter().zip(outcomes).flat_map(|(&at, outcome)| {
                let apart = self.observed[at].for_so_long(outcome.seconds).apart(outcome);
                apart.into_iter().zip(&self.off[at]).filter_map(|(apart, off)| Some(apart? / off))
            });
            // What is far off counts little more than what is off, so that one odd row does not rule.
            terms.map(|term| (term * term).ln_1p()).sum()
        };
        Some(outcomes.chunks(each).map(misfit).collect())
    }

    /// How much each figure of each row varies from seed to seed, near a point.
    fn spread(&self, point: Point) -> Option<Vec<[f64; 5]>> {
        let all = (self.observed.len(), FINE.1);
        let runs: Vec<(Sweep, Case)> = (1..=SEEDS).flat_map(|number| self.runs_of(number, point, all)).collect();
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let of_row = |(at, observed): (usize, &Observed)| {
            let seeds: Vec<Figures> = outcomes
                .iter()
                .skip(at)
                .step_by(all.0)
                .map(|outcome| observed.for_so_long(outcome.seconds).apart(outcome))
                .collect();
            std::array::from_fn(|figure| {
                let values: Vec<f64> = seeds.iter().filter_map(|figures| figures[figure]).collect();
                let mean = values.iter().sum::<f64>() / SEEDS as f64;
                let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64;
                LEAST_OFF[figure].hypot(2.0 * variance.sqrt())
            })
        };
        Some(self.observed.iter().enumerate().map(of_row).collect())
    }

    /// Goes downhill from a point, at its rate.
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

    fn result(&self, point: Point, rivals: Vec<Rate>) -> Option<Fitted> {
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
                    observed.for_so_long(outcome.seconds).apart(outcome)[figures.clone()].to_vec()
                })
                .flatten()
                .collect();
            (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt()
        };
        Some(Fitted { radio: self.radio(point), shares: rms(0..3), delays: rms(3..5), rivals, rows })
    }
}

impl Observed {
    /// The case that it is of.
    pub fn case(&self) -> Case {
        let Observed { network, addressing, reliability, retries, rate, .. } = *self;
        Case { network, addressing, reliability, retries, rate }
    }

    /// What can be held against a run of `seconds`: of a shorter one, no delays that may have grown.
    fn for_so_long(&self, seconds: f64) -> Observed {
        let mut known = self.clone();
        let shorter = self.seconds.is_some_and(|observed| seconds < 0.99 * observed);
        if shorter && self.p90_ms.or(self.p50_ms).is_some_and(|delay_ms| delay_ms > GROWS_MS) {
            (known.p50_ms, known.p90_ms) = (None, None);
        }
        known
    }

    fn row(&self, outcome: &Outcome) -> Row {
        Row::of(Source::Emulated, &self.case(), outcome)
    }

    /// How far its figures are from those of a run: differences of shares, and of the logarithms of delays.
    fn apart(&self, outcome: &Outcome) -> Figures {
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

    /// Whether it was measured, and not emulated.
    pub fn is_live(&self) -> bool {
        self.source == Some(Source::Live)
    }

    /// Checks that it is a row that such a sweep can have.
    pub fn check(&self, sweep: &Sweep) -> Result<(), String> {
        let seconds = self.seconds.unwrap_or(sweep.seconds);
        let (rates, retries) = (vec![self.rate], vec![self.retries]);
        Sweep { rates, retries, seconds, ..sweep.clone() }.check().map_err(|error| error.to_string())?;
        let share = |value: &Option<f64>| value.is_none_or(|value| (0.0..=1.0).contains(&value));
        let delay = |value: &Option<f64>| value.is_none_or(|value| value > 0.0 && value.is_finite());
        let figures = [self.delivered, self.within_20ms, self.within_50ms, self.p50_ms, self.p90_ms];
        if self.network == Network::Shaped {
            Err("it is of shaped links, and only a radio can be fitted".to_owned())
        } else if !figures[..3].iter().all(share) || !figures[3..].iter().all(delay) {
            Err("a share is not 0 to 1, or a delay is no positive number".to_owned())
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
    /// As a radio file, with what it is in its first lines.
    pub fn to_toml(&self, command: &str) -> String {
        let mut radio = self.radio.clone();
        let adhoc = self.rows.iter().all(|(observed, _)| observed.network == Network::AdHoc);
        radio.channel = if adhoc { Topology::AdHoc } else { Topology::Infrastructure };
        format!(
            "# A radio fitted to {} rows of a network study: noise_loss, background and rate.\n\
             # What is left between rows and emulation, as a root mean square: {:.1} points of the shares, {:.0} % of \
             the delays.\n# {command}\n\n{}",
            self.rows.len(),
            100.0 * self.shares,
            100.0 * (self.delays.exp() - 1.0),
            toml::to_string(&radio).expect("a radio is TOML")
        )
    }
}
