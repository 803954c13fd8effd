//! Draws pictures of one episode of `sim`: flags, files and captions.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use murmurate::messages::ids::RobotId;
use murmurate::net::media::radio::Radio;
use murmurate::report::TrialReport;
use murmurate::results::episode::Episode;
use murmurate::results::totals::Steps;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate_report::figures::picture::{Backdrop, Scene, film, moving, still};
use murmurate_robot::bad;
use murmurate_robot::output::talk;
use murmurate_robot::whole_file::WholeFile;

/// Flags of `sim` for pictures of one episode.
#[derive(clap::Args)]
pub struct Flags {
    /// File for an animation of one episode: a page with a player (.html), or an animated picture (.svg)
    #[arg(long, value_name = "FILE.html|FILE.svg")]
    animate: Option<PathBuf>,
    /// File for a still picture of one episode
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// Episode of the first repeat that --animate and --svg show: its number from 1, as the table has it, or 'failed'
    /// for the first one that did not succeed [default: 1]
    #[arg(long, value_name = "N|failed", value_parser = Shown::parse)]
    episode: Option<Shown>,
}

/// Choice of the episode that pictures show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    /// Episode with this index, from 0.
    Index(u32),
    /// First episode that did not succeed.
    Failed,
}

impl Shown {
    fn parse(text: &str) -> Result<Shown, String> {
        match text {
            "failed" => Ok(Shown::Failed),
            text => match text.parse::<u32>() {
                Ok(0) => Err("episodes count from 1, as in the table".to_owned()),
                Ok(number) => Ok(Shown::Index(number - 1)),
                Err(_) => Err("neither a number nor 'failed'".to_owned()),
            },
        }
    }

    fn is(self, episode: &Episode) -> bool {
        episode.repeat == 0
            && match self {
                Shown::Index(index) => episode.episode == index,
                Shown::Failed => episode.verdict.is_failure(),
            }
    }
}

/// Function that draws an episode and returns the text of the picture's file (SVG or HTML).
type Draw = fn(&Scene) -> String;

/// Pictures of one episode, to be drawn after a run of `sim` into files that are open already.
pub struct Pictures {
    files: Vec<(WholeFile, Draw)>,
    shown: Shown,
}

impl Pictures {
    /// Opens the files of the pictures that the flags request. `episodes` is the number of episodes of the run. An
    /// error names the flag.
    pub fn open(args: &Flags, episodes: u32) -> Result<Pictures> {
        let film: (&str, Draw) = ("html", film);
        let files = [
            ("--animate", &args.animate, vec![film, ("svg", moving)]),
            ("--svg", &args.svg, vec![("svg", still as Draw)]),
        ];
        let mut found = Vec::new();
        for (flag, path, endings) in files {
            let Some(path) = path else { continue };
            found.push((path, draw(flag, path, &endings)?));
        }
        if args.animate.is_some() && args.animate == args.svg {
            return bad("--svg: the file is that of --animate, too; give each its own".to_owned());
        }
        match args.episode {
            Some(_) if found.is_empty() => {
                return bad("--episode: there is nothing to draw; add --animate or --svg".to_owned());
            }
            Some(Shown::Index(episode)) if episode >= episodes => {
                let number = u64::from(episode) + 1;
                return bad(format!("--episode: there is no episode {number}; there are {episodes}, from 1"));
            }
            _ => {}
        }
        let open = |(path, draw): (&PathBuf, Draw)| Ok((WholeFile::create(path)?, draw));
        let files = found.into_iter().map(open).collect::<Result<Vec<_>>>()?;
        Ok(Pictures { files, shown: args.episode.unwrap_or(Shown::Index(0)) })
    }

    /// Returns true if the flags request any picture.
    pub fn any(&self) -> bool {
        !self.files.is_empty()
    }

    /// Returns which steps the trial with the index `repeat` has to keep in its report: the choice `steps`, except that
    /// repeat 0, of which pictures are, keeps the messages that robots use, too, if a picture is requested.
    pub fn steps(&self, repeat: u32, steps: Steps) -> Steps {
        if repeat == 0 && !self.files.is_empty() { Steps::WithHearing } else { steps }
    }

    /// Draws the requested pictures from the reports of all repeats, and completes their files. If the episode has no
    /// result because the run was interrupted, or if the flags ask for the first failed episode and none failed, prints
    /// that there is no picture. `policy` is the policy's name in the caption.
    pub fn draw(self, trial: &Trial, policy: &str, reports: &[TrialReport]) -> Result<()> {
        if self.files.is_empty() {
            return Ok(());
        }
        let result = |report: &TrialReport| report.episodes.iter().find(|episode| self.shown.is(episode)).copied();
        let found = reports.iter().find_map(|report| result(report).map(|episode| (report, episode)));
        let Some((report, episode)) = found else {
            talk(&match self.shown {
                Shown::Index(index) => format!("episode {} was interrupted: there is no picture of it", index + 1),
                Shown::Failed => "no episode of the first repeat failed: there is no picture".to_owned(),
            });
            return Ok(());
        };
        let scene = Scene::new(stage(trial, policy, episode.episode), &episode, &report.steps);
        for (mut file, draw) in self.files {
            file.writer().write_all(draw(&scene).as_bytes()).context("cannot write the picture")?;
            file.keep()?;
        }
        Ok(())
    }
}

/// Returns the function that draws the picture of the file `path`, by its extension; `endings` lists the extensions of
/// the flag `flag` with their functions. Fails if it has no such extension.
fn draw(flag: &str, path: &Path, endings: &[(&str, Draw)]) -> Result<Draw> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match endings.iter().find(|(known, _)| *known == ending) {
        Some((_, draw)) => Ok(*draw),
        None => {
            let known = endings.iter().map(|(known, _)| format!(".{known}")).collect::<Vec<_>>().join(" or ");
            bad(format!("{flag}: '{}' does not end in {known}", path.display()))
        }
    }
}

fn stage<'a>(trial: &'a Trial, policy: &str, episode: u32) -> Backdrop<'a> {
    let (robots, scenario) = (trial.scenario.robots(), trial.scenario.name());
    let window_s = trial.models.hold().as_secs().clamp(0.1, 1.0);
    let many = if robots == 1 { "robot" } else { "robots" };
    Backdrop {
        title: format!("{robots} {many}, scenario {scenario}, mode {}", trial.deployment.mode),
        caption: format!("policy {policy}, seed {}, episode {}", trial.seed, episode + 1),
        arena: trial.layouts.arena(episode).map_or(trial.scenario.arena(), |arena| arena),
        rules: trial.scenario.rules(),
        cost: trial.scenario.cost(),
        goals: trial.scenario.goals(),
        radius_m: trial.physics.wall_radius_m,
        window: Span::from_secs(window_s),
        tasks: trial.layouts.episode(episode),
        courses: (0..robots).map(|robot| trial.layouts.course(episode, RobotId(robot as u16))).collect(),
        chassis: trial.deployment.team_chassis().to_vec(),
        sweeps: trial.sense_layouts().into_iter().map(|(_, layout)| layout.sweep).collect(),
        radio: radio(trial),
    }
}

/// Returns the radio channel with space of a trial in which no host has several robots.
fn radio(trial: &Trial) -> Option<&Radio> {
    let alone = trial.deployment.hosts.iter().all(|host| host.agents.concat().len() <= 1);
    let mut radios = trial.deployment.links.iter().filter_map(|link| link.radio.as_ref());
    radios.find(|radio| alone && radio.has_space())
}
