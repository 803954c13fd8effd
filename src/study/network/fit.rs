//! Fits a radio to rows of a network study, measured or published: noise loss, background load and rate, nothing else.
//!
//! The emulation is run at candidate parameters and held against every figure that a row has: shares within a mark,
//! share delivered, median and 90 % delay. First on a grid over all rates, then finer around the best few. The seed
//! differs from that of the rows, so that nothing is recovered by chance.

use serde::Deserialize;

use super::case::{Addressing, Assurance, Case, Network, Sweep};
use super::medium::Medium;
use super::outcome::{Outcome, Row};
use crate::net::radio::rate::{self, Rate};
use crate::net::radio::{Radio, Topology};

/// What is known of a case: the rows of a study, or less.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Observed {
    addressing: Addressing,
    reliability: Assurance,
    retries: u32,
    network: Network,
    rate: f64,
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
    /// The rows, with the emulation at the fitted parameters beside.
    pub rows: Vec<(Observed, Row)>,
}

/// Runs cases, in any order and on any number of threads; `None` where it was told to stop.
pub type Runner<'a> = &'a dyn Fn(&[(Sweep, Case)]) -> Vec<Option<Outcome>>;

/// A share that is off by so much counts as much as a delay that is off by this factor.
const SHARE: f64 = 0.03;
const FACTOR: f64 = 0.15;
/// The grid.
const NOISES: [f64; 5] = [0.0, 0.06, 0.12, 0.2, 0.35];
const BACKGROUNDS: [f64; 5] = [0.0, 0.15, 0.3, 0.45, 0.6];
/// How many rows, for how long, on the grid, and around its best points \[s\].
const COARSE: (usize, f64) = (8, 4.0);
const FINE: (usize, f64) = (20, 12.0);
/// How many rates go on from the grid.
const BEST: usize = 4;
/// The first steps around them, of noise and background, and how often they are halved.
const STEPS: (f64, f64) = (0.04, 0.08);
const HALVINGS: u32 = 6;

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
}

/// Fits `base` to what was observed with the stations, messages and history of `sweep`. `None` once the runner stops.
///
/// Panics if nothing was observed.
pub fn fit(base: &Radio, sweep: &Sweep, observed: &[Observed], runner: Runner) -> Option<Fitted> {
    assert!(!observed.is_empty(), "a fit needs rows");
    let fit = Fit { base, sweep, observed, runner };
    let mut grid = Vec::new();
    // Of another generation of 802.11 there is a rate as fast as almost any: rows cannot tell the two apart.
    let own = family(base.rate);
    for rate in rate::all().filter(|rate| rate.fits(base.width_mhz) && (fit.only_multicast() || family(*rate) == own)) {
        for noise in NOISES {
            grid.extend(BACKGROUNDS.map(|background| Point { rate, noise, background }));
        }
    }
    let mut coarse: Vec<(f64, Point)> = fit.misfits(&grid, COARSE)?.into_iter().zip(grid).collect();
    coarse.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut best: Option<(f64, Point)> = None;
    let mut rates: Vec<Rate> = Vec::new();
    for (_, point) in coarse {
        if rates.len() < BEST && !rates.contains(&point.rate) {
            rates.push(point.rate);
            let found = fit.refine(point)?;
            if best.is_none_or(|(misfit, _)| found.0 < misfit) {
                best = Some(found);
            }
        }
    }
    fit.result(best.expect("a grid has points").1)
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

    fn runs(&self, point: Point, (rows, seconds): (usize, f64)) -> Vec<(Sweep, Case)> {
        let medium = Medium::Radio(self.radio(point));
        let seed = self.sweep.seed.wrapping_add(0x5eed);
        let sweep = Sweep { medium, seconds, seed, ..self.sweep.clone() };
        let every = self.observed.len().div_ceil(rows);
        self.observed.iter().step_by(every).map(|observed| (sweep.clone(), observed.case())).collect()
    }

    /// How far each point is from what was observed.
    fn misfits(&self, points: &[Point], effort: (usize, f64)) -> Option<Vec<f64>> {
        let runs: Vec<(Sweep, Case)> = points.iter().flat_map(|point| self.runs(*point, effort)).collect();
        let each = runs.len() / points.len();
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let every = self.observed.len().div_ceil(effort.0);
        let misfit = |outcomes: &[Outcome]| {
            let pairs = self.observed.iter().step_by(every).zip(outcomes);
            // What is far off counts little more than what is off, so that one odd row does not rule.
            let terms = pairs.flat_map(|(observed, outcome)| observed.differences(&observed.row(outcome)).concat());
            terms.map(|term| (term * term).ln_1p()).sum()
        };
        Some(outcomes.chunks(each).map(misfit).collect())
    }

    /// Goes downhill from a point of the grid, at its rate.
    fn refine(&self, from: Point) -> Option<(f64, Point)> {
        let mut best = (self.misfits(&[from], FINE)?[0], from);
        let mut steps = STEPS;
        for _ in 0..HALVINGS {
            loop {
                let around = |&(noise, background): &(f64, f64)| Point {
                    noise: (best.1.noise + noise * steps.0).clamp(0.0, 1.0),
                    background: (best.1.background + background * steps.1).clamp(0.0, 1.0),
                    ..best.1
                };
                let ways = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, -1.0), (-1.0, 1.0)];
                let points: Vec<Point> = ways.iter().map(around).filter(|point| *point != best.1).collect();
                let misfits = self.misfits(&points, FINE)?;
                let found = misfits.into_iter().zip(points).min_by(|a, b| a.0.total_cmp(&b.0)).expect("there are ways");
                if found.0 >= best.0 {
                    break;
                }
                best = found;
            }
            steps = (steps.0 / 2.0, steps.1 / 2.0);
        }
        Some(best)
    }

    fn result(&self, point: Point) -> Option<Fitted> {
        let runs = self.runs(point, (self.observed.len(), self.sweep.seconds));
        let outcomes: Vec<Outcome> = (self.runner)(&runs).into_iter().collect::<Option<_>>()?;
        let rows: Vec<(Observed, Row)> = self
            .observed
            .iter()
            .zip(&outcomes)
            .map(|(observed, outcome)| (observed.clone(), observed.row(outcome)))
            .collect();
        let rms = |at: usize, scale: f64| {
            let all: Vec<f64> = rows.iter().flat_map(|(observed, row)| observed.differences(row)[at].clone()).collect();
            scale * (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt()
        };
        Some(Fitted { radio: self.radio(point), shares: rms(0, SHARE), delays: rms(1, FACTOR), rows })
    }
}

impl Observed {
    /// The case that it is of.
    pub fn case(&self) -> Case {
        let Observed { network, addressing, reliability, retries, rate, .. } = *self;
        Case { network, addressing, reliability, retries, rate }
    }

    fn row(&self, outcome: &Outcome) -> Row {
        Row::of("emulated", &self.case(), outcome)
    }

    /// In units of what counts as off: of shares, and of delays.
    fn differences(&self, row: &Row) -> [Vec<f64>; 2] {
        let shares =
            [(self.delivered, row.delivered), (self.within_20ms, row.within_20ms), (self.within_50ms, row.within_50ms)];
        let shares = shares.into_iter().filter_map(|(seen, emulated)| Some((seen? - emulated) / SHARE)).collect();
        let delays = [(self.p50_ms, row.p50_ms), (self.p90_ms, row.p90_ms)];
        let delays = delays.into_iter().filter_map(|(seen, emulated)| {
            let (seen, emulated) = (seen?, emulated.unwrap_or(1e4));
            Some((seen.max(0.05) / emulated.max(0.05)).ln() / FACTOR)
        });
        [shares, delays.collect()]
    }

    /// Whether it is of a radio.
    pub fn is_of_radio(&self) -> bool {
        self.network != Network::Shaped
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
