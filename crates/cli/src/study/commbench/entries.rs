//! Entries of the benchmark: the trial of each policy in each cell, made by the flags of `sim`.

use std::path::Path;

use anyhow::Result;
use murmurate::registry::Registry;
use murmurate::scenario::task_file::BUILT_IN;
use murmurate_robot::BadInput;
use murmurate_study::commbench::Entry;
use murmurate_study::commbench::matrix::{Cell, Empty, KINDS};

use super::entered::Entered;
use crate::sim::trial::{self, Defined};
use crate::study::sweep::given::{self, Given};
use crate::study::sweep::place::Place;

/// Entries of a benchmark, with what was found while they were made.
pub struct Made {
    /// Policies in the cells, ordered by cell and then by entrant.
    pub entries: Vec<Entry>,
    /// Places that are empty because a policy that was entered for all tasks does not fit one.
    pub empty: Vec<Empty>,
    /// Warnings about policies, each once.
    pub warnings: Vec<String>,
}

/// Policy of an entrant in a task.
struct Candidate<'a> {
    policy: &'a Path,
    /// Whether it may be of no use in a task: it was entered for all that it fits.
    tried: bool,
}

/// Returns the entries of these cells and entrants. An error says which policy cannot run, and where.
pub fn of(
    (cells, entrants): (&[Cell], &[String]),
    entered: &[Entered],
    episodes: Option<u32>,
    registry: &Registry,
) -> Result<Made> {
    let registry = &with_tasks(registry)?;
    let mut made = Made { entries: Vec::new(), empty: Vec::new(), warnings: Vec::new() };
    for (at, cell) in cells.iter().enumerate() {
        for entrant in entrants {
            let Some(candidate) = candidate(cell, entrant, entered) else { continue };
            let found = trial_of(cell, candidate.policy, registry);
            let Defined { trial, policy, warnings } = match found.map_err(anyhow::Error::downcast::<BadInput>) {
                Ok(defined) => defined,
                Err(Ok(BadInput(why))) if candidate.tried => {
                    made.leave(cell, entrant, why);
                    continue;
                }
                Err(Ok(BadInput(why))) => return Err(BadInput(format!("{entrant}, {}: {why}", cell.words())).into()),
                Err(Err(error)) => return Err(error),
            };
            made.warn(warnings);
            let mut conditions: Vec<String> =
                cell.settings().into_iter().map(|(name, value)| format!("{name}={value}")).collect();
            conditions.push(format!("{:?}", cell.channel.air));
            conditions.extend(given::digest(candidate.policy));
            let (episodes, entrant) = (episodes.unwrap_or(cell.task.episodes), entrant.clone());
            made.entries.push(Entry { cell: at, entrant, policy, trial, episodes, conditions });
        }
    }
    let absent = |one: &&Entered| made.entries.iter().all(|entry| entry.entrant != one.name);
    if let Some(one) = entered.iter().find(absent) {
        let why = made.empty.iter().find(|empty| empty.policy.as_ref() == Some(&one.name));
        let why = why.map_or("it fits no task", |empty| &empty.why);
        return Err(BadInput(format!("--enter {one}: {why}")).into());
    }
    Ok(made)
}

impl Made {
    /// Notes once for each task that an entered policy does not fit it.
    fn leave(&mut self, cell: &Cell, entrant: &str, why: String) {
        let (task, policy) = (cell.task.name.to_owned(), Some(entrant.to_owned()));
        if !self.empty.iter().any(|empty| (&empty.task, &empty.policy) == (&task, &policy)) {
            self.empty.push(Empty { task, channel: None, policy, why });
        }
    }

    fn warn(&mut self, warnings: Vec<String>) {
        for warning in warnings {
            if !self.warnings.contains(&warning) {
                self.warnings.push(warning);
            }
        }
    }
}

/// Returns the registry with the tasks that have a file of the library, so that no path is needed.
fn with_tasks(registry: &Registry) -> Result<Registry> {
    BUILT_IN.iter().try_fold(registry.clone(), |registry, (name, text)| Ok(registry.with_task_text(name, text)?))
}

/// Returns the policy of an entrant in the task of a cell; `None` if there is none.
fn candidate<'a>(cell: &Cell, entrant: &str, entered: &'a [Entered]) -> Option<Candidate<'a>> {
    if let Some(kind) = KINDS.iter().position(|kind| *kind == entrant) {
        return cell.task.policies[kind].ok().map(|policy| Candidate { policy: Path::new(policy), tried: false });
    }
    let mine = entered.iter().filter(|one| one.name == entrant);
    let mut fits = mine.filter(|one| one.task.is_none_or(|task| task == cell.task.name));
    fits.next().map(|one| Candidate { policy: &one.policy, tried: one.task.is_none() })
}

/// Returns the trial of a policy in a cell, of one episode.
fn trial_of(cell: &Cell, policy: &Path, registry: &Registry) -> Result<Defined> {
    let settings = cell.settings();
    let point: Vec<(Place, &str)> = settings.iter().map(|(name, value)| (Place::of(name), value.as_str())).collect();
    let setup = Given::none().at(&point)?;
    trial::of_flags(&setup, (0, 1), Some(policy), (registry, &|_| None))
}
