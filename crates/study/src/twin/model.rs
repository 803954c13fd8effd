//! The twin's model: parameters fitted to some episodes of a run, values given by the user instead, and the simulation
//! with these parameters.

use std::borrow::Cow;
use std::ops::Range;

use super::estimate::Estimate;
use super::lag::{self, Limits, Slip};
use super::links::{self, FittedLink};
use super::observed::Run;
use super::offsets;
use super::path::{self, PathLoss};
use murmurate::deploy::Deployment;
use murmurate::messages::ids::{LinkId, RobotId};
use murmurate::random::Seed;
use murmurate::trial::Trial;

/// Parameters of the twin that were fitted to some episodes of a recorded run. A parameter is `None` if it cannot be
/// found from the records.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fitted {
    /// Time constant \[s\] of the first-order lag from commanded to true velocity.
    pub lag_s: Option<Estimate>,
    /// Time \[s\] until a command has an effect on the velocities; `None` unless the lag was found from the robots' own
    /// estimates, or from the log of another program.
    pub late_s: Option<f64>,
    /// Slip of the wheels: random difference between driven and commanded velocity.
    pub slip: Option<Slip>,
    /// Delay and loss of each link of the deployment, in its order of links; `None` for a link without data.
    pub links: Vec<Option<FittedLink>>,
    /// Delay and loss of all links together; `None` without data.
    pub all_links: Option<FittedLink>,
    /// Path loss between robots; `None` if the share of messages that arrive does not fall with the distance, or
    /// distances are not known.
    pub path: Option<PathLoss>,
    /// Offset \[s\] of each robot's control ticks from the steps of the simulated World, or from robot 0's ticks if no
    /// steps were recorded; `None` if it is unknown or not constant.
    pub offsets_s: Vec<Option<f64>>,
}

/// Known properties of a recorded run and its team, from which a fit starts.
#[derive(Clone, Debug)]
pub struct Basis {
    /// Time from one step of a robot to the next \[ns\].
    pub period_ns: i64,
    /// Limits of the robots' drivetrain.
    pub limits: Limits,
    /// Whether slip is looked for: not in a world that has none.
    pub slips: bool,
    /// Whether it is not known which step a command drives, as in the log of another program. Then it is looked for.
    pub matches: bool,
    /// Number of robots.
    pub robots: usize,
    /// Names of the links, by their ids.
    pub links: Vec<String>,
    /// Seed of the bootstrap of the intervals.
    pub seed: u64,
}

impl Basis {
    /// Returns what a fit takes as given of a trial, which has the settings of the recorded run.
    pub fn of(trial: &Trial) -> Basis {
        let period_ns = trial.models.period().as_nanos() as i64;
        let plant = trial.registry.plant(&trial.deployment.plant);
        Basis {
            period_ns,
            limits: limits(trial, period_ns),
            slips: plant.is_ok_and(|plant| plant.name != murmurate::world::KINEMATIC),
            matches: false,
            robots: trial.deployment.robots,
            links: trial.deployment.links.iter().map(|link| link.name.clone()).collect(),
            seed: trial.seed,
        }
    }
}

/// Values given by the user that replace fitted parameters of the twin. `None` leaves the fitted one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Given {
    /// Time constant of the drivetrain's lag \[s\].
    pub lag_s: Option<f64>,
    /// Standard deviation of wheel slip, as a share of the commanded speed.
    pub slip: Option<f64>,
    /// One-way delay of every link \[s\].
    pub delay_s: Option<f64>,
    /// Loss probability of every link, 0 to 1.
    pub loss: Option<f64>,
}

impl Given {
    /// Names of the values that a user can give, in the order of the fields.
    pub const NAMES: [&str; 4] = ["lag_s", "slip", "delay_s", "loss"];

    /// Sets the value with this name, one of [`Given::NAMES`]. The error is a text that says what is wrong with name or
    /// value.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), String> {
        let (place, most) = match name {
            "lag_s" => (&mut self.lag_s, 10.0),
            "slip" => (&mut self.slip, 1.0),
            "delay_s" => (&mut self.delay_s, 60.0),
            "loss" => (&mut self.loss, 1.0),
            _ => return Err(format!("there is no '{name}'; there are {}", Given::NAMES.join(", "))),
        };
        if !(0.0..=most).contains(&value) {
            return Err(format!("{value} is not 0 to {most}"));
        }
        *place = Some(value);
        Ok(())
    }

    /// Returns the parameters `fitted`, each replaced by the value that the user gave, if there is one.
    pub fn over(&self, mut fitted: Fitted) -> Fitted {
        let exact = |given: Option<f64>, place: &mut Option<Estimate>| *place = given.map(Estimate::exact).or(*place);
        if let Some(lag_s) = self.lag_s {
            fitted.lag_s = Some(Estimate::exact(lag_s));
        }
        if let Some(slip) = self.slip {
            let time_s = fitted.slip.map_or(0.0, |slip| slip.time_s);
            fitted.slip = Some(Slip { share: Estimate::exact(slip), time_s });
        }
        if self.delay_s.is_some() || self.loss.is_some() {
            fitted.all_links.get_or_insert_default();
        }
        for link in fitted.links.iter_mut().flatten().chain(&mut fitted.all_links) {
            exact(self.delay_s, &mut link.delay_s);
            exact(self.loss, &mut link.loss);
        }
        fitted
    }
}

/// Returns the limits of speed and acceleration of the robots' drivetrain in a trial. `period_ns` is the duration of a
/// step \[ns\].
fn limits(trial: &Trial, period_ns: i64) -> Limits {
    let physics = &trial.physics;
    Limits {
        step_s: period_ns as f64 / 1e9,
        speed_m_s: f64::from(physics.top_speed_m_s),
        axis_m_s2: f64::from(physics.acceleration_m_s2),
        total_m_s2: f64::from(physics.traction_m_s2),
    }
}

/// Fits all parameters of the twin (lag, slip, links, tick offsets) to the episodes `episodes` of a recorded run.
pub fn fit(run: &Run, basis: &Basis, episodes: Range<u32>) -> Fitted {
    let Basis { period_ns, limits, .. } = basis;
    let seed = Seed::of_run(basis.seed).child("twin");
    let within = episodes.start as usize..episodes.end as usize;
    let (mut motion, mut late_s) = (Cow::Borrowed(&run.motion[within.clone()]), None);
    if basis.matches {
        let (matched, steps) = lag::matched(&motion, limits);
        (motion, late_s) = (Cow::Owned(matched), Some(steps as f64 * limits.step_s));
    }
    let mut stream = seed.stream("lag");
    let of_truth = lag::fit(&motion, limits, &mut stream);
    let of_estimates =
        if of_truth.is_none() { lag::fit_estimates(&run.estimates[within.clone()], limits, &mut stream) } else { None };
    let lag_s = of_truth.or(of_estimates.map(|(lag_s, _)| lag_s));
    let late_s = of_estimates.map(|(_, late_s)| late_s).or(late_s.filter(|_| of_truth.is_some()));
    let slip = of_truth.filter(|_| basis.slips);
    let slip = slip.and_then(|lag_s| lag::slip(&motion, lag_s.value, limits, &mut seed.stream("slip")));
    let link = |link: Option<LinkId>, name: &str| {
        links::fit(&run.crossings, link, episodes.clone(), &mut seed.stream(&format!("link/{name}")))
    };
    let named = basis.links.iter().zip(0..);
    let links = named.map(|(name, number)| link(Some(LinkId(number)), name)).collect();
    // If no World's steps were recorded, offsets are from the ticks of the first robot.
    let steps = run.steps_ns[within].iter().flatten().copied();
    let ticks = |robot: usize| {
        let ticks = run.ticks_ns.get(robot).into_iter().flatten();
        offsets::steady(ticks.filter(|(episode, _)| episodes.contains(episode)).map(|(_, ns)| *ns), *period_ns)
    };
    let step =
        if run.steps_ns.iter().any(|steps| !steps.is_empty()) { offsets::steady(steps, *period_ns) } else { ticks(0) };
    let offset = |robot: usize| Some(offsets::between(ticks(robot)?, step?, *period_ns));
    let offsets_s = (0..basis.robots).map(offset).collect();
    let all_links = link(None, "all").map(|all| if basis.matches { all.of_clocks() } else { all });
    let path = path::fit(&run.crossings, episodes, &mut seed.stream("path"));
    Fitted { lag_s, late_s, slip, links, all_links, path, offsets_s }
}

/// Returns the deployment with delay and loss of its links, and offsets of the robots' ticks, replaced by fitted ones.
/// A value that was not found stays as it is.
pub fn deployment(fitted: &Fitted, mut deployment: Deployment) -> Deployment {
    for (link, found) in deployment.links.iter_mut().zip(&fitted.links) {
        let Some(found) = found else { continue };
        link.delay_s = found.delay_s.map_or(link.delay_s, |delay_s| rounded(delay_s.value.max(0.0), 1e6));
        link.loss = found.loss.map_or(link.loss, |loss| rounded(loss.value.clamp(0.0, 1.0), 1e4));
        link.impairs.clone_from(&link.carries);
    }
    for host in &mut deployment.hosts {
        let first = |robots: &Vec<u16>| robots.iter().min().map(|robot| RobotId(*robot));
        let offset = |robots| first(robots).and_then(|robot| fitted.offsets_s.get(robot.index()).copied().flatten());
        let offsets: Option<Vec<f64>> = host.agents.iter().map(|robots| Some(rounded(offset(robots)?, 1e6))).collect();
        host.tick_offsets_s = offsets.unwrap_or_default();
    }
    deployment
}

/// Returns `value` rounded to a multiple of 1 / `places`, so that files are readable.
pub fn rounded(value: f64, places: f64) -> f64 {
    (value * places).round() / places
}

/// Returns the trial that predicts the episodes of a run from the number `first` on, with the parameters `fitted`.
/// `trial` has the run's own settings.
pub fn simulation(fitted: &Fitted, trial: &Trial, first: u32) -> Trial {
    let mut twin = trial.clone();
    twin.deployment = deployment(fitted, twin.deployment);
    twin.layouts = twin.layouts.since(first);
    if let Some(lag_s) = fitted.lag_s {
        twin.physics.lag_s = rounded(lag_s.value, 1e4) as f32;
    }
    if let Some(slip) = fitted.slip {
        twin.physics.slip = rounded(slip.share.value, 1e4) as f32;
        twin.physics.slip_s = rounded(slip.time_s, 1e3) as f32;
    }
    twin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delay_and_loss_that_are_given_hold_without_any_message() {
        let mut given = Given::default();
        given.set("delay_s", 0.02).expect("it is a delay");
        let all = given.over(Fitted::default()).all_links.expect("it was given");
        assert_eq!((all.delay_s, all.loss), (Some(Estimate::exact(0.02)), None));
        given.set("loss", 0.1).expect("it is a probability");
        let all = given.over(Fitted::default()).all_links.expect("it was given");
        assert_eq!(all.loss, Some(Estimate::exact(0.1)));
        assert_eq!(Given::default().over(Fitted::default()).all_links, None);
    }
}
