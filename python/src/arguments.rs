//! Arguments of `VecEnv`, from Python values to the settings of environments. A wrong one is a `ValueError` that begins
//! with its name.

use std::sync::Arc;

use murmurate::deploy::senses_of;
use murmurate::policy::hops::entry::Entry;
use murmurate::policy::manifest::Field;
use murmurate::scenario::{Scenario, ScenarioError, Settings, TaskFile};
use murmurate::senses;
use murmurate_train::config::{Conditions, Config, CurriculumStage, Reward};
use murmurate_train::imitation::config::{Config as Imitation, PRESET};
use murmurate_train::vector::{Autoreset, Content, Lidar, Options};
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;

use crate::task::PythonTask;

/// Value of an argument, if it is given.
pub type Given<'a, 'py> = Option<&'a Bound<'py, PyAny>>;

/// Scenario of the environments, with the task in Python that it is of, if it is of one.
type Found = (Arc<dyn Scenario>, Option<Arc<PythonTask>>);

/// Returns a `ValueError` that names the argument.
pub fn wrong(argument: &str, why: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("{argument}: {why}"))
}

/// Returns a value as Python writes it, for an error.
fn shown(value: &Bound<'_, PyAny>) -> String {
    value.repr().map_or_else(|_| value.get_type().to_string(), |text| text.to_string().chars().take(80).collect())
}

/// Returns a whole number within these bounds, both included.
pub fn whole(argument: &str, value: &Bound<'_, PyAny>, least: i64, most: i64) -> PyResult<i64> {
    let number = value.extract::<i64>().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| wrong(argument, format!("{} is not {least} to {most}", shown(value))))
}

/// Returns a number within these bounds, both included.
fn number(argument: &str, value: &Bound<'_, PyAny>, least: f64, most: f64) -> PyResult<f32> {
    let number = value.extract::<f64>().ok().filter(|number| (least..=most).contains(number));
    let number = number.ok_or_else(|| wrong(argument, format!("{} is not {least} to {most}", shown(value))))?;
    Ok(number as f32)
}

/// Returns a number; its range is for the caller.
pub fn float(argument: &str, value: &Bound<'_, PyAny>) -> PyResult<f64> {
    value.extract::<f64>().map_err(|_| wrong(argument, format!("{} is no number", shown(value))))
}

/// Returns a text, or a path as a text.
pub fn text(argument: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    let path = || value.py().import("os")?.call_method1("fspath", (value,))?.extract::<String>();
    path().map_err(|_| wrong(argument, format!("{} is no text", shown(value))))
}

/// Seed of random streams: a whole number of 64 bits without a sign.
pub struct Seed(pub u64);

impl<'py> FromPyObject<'_, 'py> for Seed {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Seed> {
        let refused = |_| wrong("seed", format!("{} is not 0 to {}, nor None", shown(&value), u64::MAX));
        value.extract::<u64>().map(Seed).map_err(refused)
    }
}

impl Seed {
    /// Returns the seed that is given, or one that the operating system draws. That one fits into a signed number of 64
    /// bits, too.
    pub fn or_drawn(given: Option<Seed>, py: Python<'_>) -> PyResult<u64> {
        if let Some(Seed(seed)) = given {
            return Ok(seed);
        }
        let drawn: [u8; 8] = py.import("os")?.call_method1("urandom", (8,))?.extract()?;
        Ok(u64::from_le_bytes(drawn) >> 1)
    }
}

/// Arguments of `VecEnv` as they are given.
pub struct Arguments<'a, 'py> {
    pub scenario: Given<'a, 'py>,
    pub num_envs: Given<'a, 'py>,
    pub threads: Given<'a, 'py>,
    pub conditions: Given<'a, 'py>,
    pub message: Given<'a, 'py>,
    pub message_size: Given<'a, 'py>,
    pub autoreset: Given<'a, 'py>,
    pub num_robots: Given<'a, 'py>,
    pub gap_m: Given<'a, 'py>,
    pub episode_s: Given<'a, 'py>,
    pub config: Given<'a, 'py>,
    pub stage: Given<'a, 'py>,
    pub penalties: Given<'a, 'py>,
    pub repeat: Given<'a, 'py>,
    pub radio: Given<'a, 'py>,
    pub filtered: Given<'a, 'py>,
    pub scale: Given<'a, 'py>,
    pub hull_m: Given<'a, 'py>,
    pub senses: Given<'a, 'py>,
}

/// Reads a text among `names`, or the first of them if it is not given; returns its index.
fn choice(argument: &str, given: Given, names: &[&str]) -> PyResult<usize> {
    let Some(value) = given else { return Ok(0) };
    let value = text(argument, value)?;
    names.iter().position(|name| *name == value).ok_or_else(|| {
        let names: Vec<String> = names.iter().map(|name| format!("'{name}'")).collect();
        wrong(argument, format!("'{value}' is not {}", names.join(" or ")))
    })
}

impl Arguments<'_, '_> {
    /// Returns the settings that the arguments stand for; those that are left out are the configuration's. `seed` is
    /// that of the random streams. Also returns the task in Python, if the scenario is one.
    pub fn options(&self, py: Python<'_>, seed: u64) -> PyResult<(Options, Option<Arc<PythonTask>>)> {
        let count = |argument, given: Given, most| given.map(|value| whole(argument, value, 1, most)).transpose();
        let environments = count("num_envs", self.num_envs, 1 << 20)?.unwrap_or(1) as usize;
        let threads = count("threads", self.threads, 1024)?.unwrap_or(1) as usize;
        let repeat = count("repeat", self.repeat, 100)?;
        let (content, autoreset) = (self.content()?, [Autoreset::SameStep, Autoreset::Disabled]);
        let autoreset = autoreset[choice("autoreset", self.autoreset, &["same-step", "disabled"])?];
        let (config, file) = self.config()?;
        let robots = count("num_robots", self.num_robots, 1_000_000)?.map(|robots| robots as usize).or(config.robots);
        let stage = self.stage(&config)?.cloned();
        let gap_m = self.gap_m.map(|gap_m| number("gap_m", gap_m, 1e-3, 1e3)).transpose()?;
        let gap_m = gap_m.or(stage.as_ref().and_then(|stage| stage.gap_m));
        let scale = self.scale.map(|scale| number("scale", scale, 1e-3, 1e3)).transpose()?.or(config.scale);
        let hull_m = self.hull_m.map(|hull_m| number("hull_m", hull_m, 1e-3, 1e3)).transpose()?.or(config.hull_m);
        let (scenario, task) = self.scenario(&Settings { robots, gap_m, scale, hull_m })?;
        let config = match self.config {
            None if scenario.cost().is_some() => without_goals(&*scenario, config),
            // A file says all weights itself.
            _ if file.is_none() => Config { reward: config.reward.weighted(scenario.weights()), ..config },
            _ => config,
        };
        if let Some(stage) =
            stage.as_ref().filter(|stage| stage.groups.iter().any(|group| *group != [scenario.robots()]))
        {
            let why = format!("its groups {:?} are not the whole team of {}", stage.groups, scenario.robots());
            return Err(wrong("stage", format!("{why}; take another one, or num_robots=")));
        }
        let penalties = self.penalties.map(|factor| number("penalties", factor, 0.0, 100.0)).transpose()?;
        if let (Some(file), None, None) = (file, &stage, penalties) {
            warn_of_curriculum(py, &file, &config, scenario.robots())?;
        }
        let episode_s = self.episode_s.map(|episode_s| number("episode_s", episode_s, 0.05, 3600.0)).transpose()?;
        let lidar = self.lidar(scenario.task_file())?;
        let options = Options {
            conditions: self.conditions(config.conditions.clone(), &*scenario)?,
            scenario,
            gap_m,
            scale,
            hull_m,
            environments,
            threads,
            reward: config
                .reward
                .with_penalties(penalties.or(stage.as_ref().map(|stage| stage.penalties)).unwrap_or(1.0)),
            body: config.body.clone(),
            observation: config.policy.observation.iter().filter_map(Entry::field).collect(),
            radius_m: config.policy.radius_m,
            limit_m_s: config.policy.limit_m_s,
            episode_s: episode_s.unwrap_or(config.episode_s),
            repeat: repeat.map_or(stage.map_or(1, |stage| stage.repeat), |repeat| repeat as u32),
            hold_s: config.policy.hold_s,
            content,
            autoreset,
            lidar,
            seed,
        };
        options.check().map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok((options, task))
    }

    /// Returns the scenario of these settings, by its name or as a task in Python.
    fn scenario(&self, settings: &Settings) -> PyResult<Found> {
        let task = self.scenario.map(PythonTask::of).transpose()?.flatten();
        let made = match &task {
            Some(task) => task.file()?.scenario(settings),
            None => {
                let name = self.scenario.map_or(Ok("passage".to_owned()), |name| text("scenario", name))?;
                crate::registry().scenario(&name, settings)
            }
        };
        let scenario = made.map_err(|error| match (&task, error) {
            (Some(task), ScenarioError::TaskFile { error, .. }) => task.wrong(error),
            (Some(_), error @ ScenarioError::Robots { .. }) => wrong("num_robots", error),
            (_, error @ ScenarioError::Size { .. }) => wrong(error.field(), error),
            (_, error) => wrong("scenario", error),
        })?;
        Ok((scenario, task))
    }

    /// Returns what messages between robots carry.
    fn content(&self) -> PyResult<Content> {
        let content = match self.message {
            None => Content::Nothing,
            Some(_) => match choice("message", self.message, &["observations", "action"])? {
                0 => Content::Observations,
                _ => Content::Actions(16),
            },
        };
        match (content, self.message_size) {
            (Content::Actions(_), Some(size)) => Ok(Content::Actions(whole("message_size", size, 1, 1024)? as usize)),
            (_, Some(_)) => Err(wrong("message_size", "it has no effect without message='action'")),
            (content, None) => Ok(content),
        }
    }

    /// Returns the lidar in a file of senses, as `sim --senses` takes it, or else that of a task file with one lidar.
    fn lidar(&self, task: Option<&TaskFile>) -> PyResult<Option<Lidar>> {
        let Some(given) = self.senses else {
            let of_task = task.into_iter().flat_map(TaskFile::senses);
            let named = of_task.map(|(name, settings)| (name.clone(), senses::Settings::of_task(settings.clone())));
            let mut lidars = named.filter(|(_, settings)| settings.kind == "lidar");
            let (first, second) = (lidars.next(), lidars.next());
            return Ok(first.filter(|_| second.is_none()).map(|(name, settings)| Lidar { name, settings }));
        };
        let file = text("senses", given)?;
        let content = std::fs::read_to_string(&file).map_err(|error| wrong("senses", format!("'{file}': {error}")))?;
        let senses = senses_of(&content).map_err(|error| wrong("senses", format!("'{file}': {error}")))?;
        let mut all = senses.into_iter();
        match (all.next(), all.next()) {
            (Some((name, settings)), None) => Ok(Some(Lidar { name, settings })),
            _ => Err(wrong("senses", format!("'{file}' has not one sense, which is a lidar"))),
        }
    }

    /// Returns the configuration of a preset, or that in a TOML file, and then the file's name.
    fn config(&self) -> PyResult<(Config, Option<String>)> {
        let given = self.config.map_or(Ok("robust".to_owned()), |given| text("config", given))?;
        if let Some(config) = Config::preset(&given) {
            return Ok((config, None));
        }
        let content = std::fs::read_to_string(&given)
            .map_err(|error| wrong("config", format!("'{given}' is neither a preset nor a file: {error}")))?;
        if Imitation::is_in(&content) {
            return Err(wrong("config", format!("'{given}' is of a training by imitation, which has no rewards")));
        }
        let config = Config::from_toml(&content).map_err(|error| wrong("config", format!("'{given}': {error}")))?;
        Ok((config, Some(given)))
    }

    /// Returns the stage of the curriculum that is asked for; a negative number counts from the end.
    fn stage<'c>(&self, config: &'c Config) -> PyResult<Option<&'c CurriculumStage>> {
        let Some(given) = self.stage else { return Ok(None) };
        let stages = config.curriculum.len() as i64;
        let at = whole("stage", given, -stages, stages - 1)?;
        Ok(Some(&config.curriculum[at.rem_euclid(stages) as usize]))
    }

    /// Returns the conditions of this name, from those of a training's configuration.
    fn conditions(&self, configured: Conditions, scenario: &dyn Scenario) -> PyResult<Conditions> {
        let name = choice("conditions", self.conditions, &["perfect", "robust", "late"])?;
        for (argument, given) in [("radio", self.radio), ("filtered", self.filtered)] {
            if given.is_some() && name == 0 {
                return Err(wrong(argument, "it has no effect with conditions='perfect'; take 'late' or 'robust'"));
            }
        }
        let mut conditions = match name {
            0 => Conditions { clean: 1.0, deployed: 0.0, everyone: 0.0, ..configured },
            1 => configured,
            _ => Conditions { clean: 0.0, deployed: 1.0, everyone: 0.0, ..configured },
        };
        if let Some(radio) = self.radio {
            let radio = text("radio", radio)?;
            murmurate_cli::with_radio("radio", &radio, scenario, &mut conditions).map_err(crate::program::exception)?;
        }
        if let Some(filtered) = self.filtered {
            conditions.filtered = number("filtered", filtered, 0.0, 1.0)?;
        }
        Ok(conditions)
    }
}

/// Returns the configuration for a scenario whose robots have no goals: the scenario's own reward and nothing else, the
/// duration of its episodes, and the observation and the limits of trainings by imitation.
fn without_goals(scenario: &dyn Scenario, config: Config) -> Config {
    let learnt = Imitation::preset(PRESET).expect("the program has it").policy;
    let reward = Reward {
        scale: 1.0,
        scenario: 1.0,
        progress: 0.0,
        arrival: 0.0,
        time: 0.0,
        team_time: 0.0,
        shared: 0.0,
        filtered: 1.0,
        ..config.reward.with_penalties(0.0)
    };
    let mut config = Config { reward, episode_s: scenario.rules().limit.as_secs() as f32, ..config };
    config.policy.observation = vec![Field::Position.into(), Field::Velocity.into()];
    (config.policy.radius_m, config.policy.limit_m_s) = (learnt.radius_m, learnt.limit_m_s);
    config.policy.hold_s = learnt.hold_s;
    config
}

/// Warns of what the curriculum of a configuration says and environments without `stage` do not take.
fn warn_of_curriculum(py: Python<'_>, file: &str, config: &Config, robots: usize) -> PyResult<()> {
    let any = |other: &dyn Fn(&CurriculumStage) -> bool| config.curriculum.iter().any(other);
    let fields = [
        ("groups", any(&|stage| stage.groups.iter().any(|group| *group != [robots]))),
        ("repeat", any(&|stage| stage.repeat != 1)),
        ("gap_m", any(&|stage| stage.gap_m.is_some())),
        ("penalties", any(&|stage| stage.penalties != 1.0)),
    ];
    let fields: Vec<&str> = fields.iter().filter(|(_, other)| *other).map(|(name, _)| *name).collect();
    if fields.is_empty() {
        return Ok(());
    }
    let (named, last) = (fields.join(", "), config.curriculum.len() - 1);
    let said = format!(
        "config: '{file}' has a curriculum whose {named} are not taken: stage=0 to {last} takes them of one stage, \
         penalties=1 says that none is wanted"
    );
    let said = std::ffi::CString::new(said.replace('\0', "")).expect("it has no zero byte");
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &said, 1)
}
