//! Policies that a user enters with `--enter`, for one task or for all that they fit.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use murmurate_robot::bad;
use murmurate_study::commbench::matrix::{KINDS, REFERENCE, TASKS, Task};

/// Longest name of an entered policy \[characters\].
const LONGEST: usize = 32;

/// Policy that is entered: value of `--enter`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entered {
    /// Name of its column.
    pub name: String,
    /// Policy as `sim --policy` takes it: a name, or a file.
    pub policy: PathBuf,
    /// Task that it is entered for; `None` for all that it fits.
    pub task: Option<&'static str>,
}

impl FromStr for Entered {
    type Err = String;

    fn from_str(text: &str) -> Result<Entered, String> {
        let wrong =
            || format!("'{text}' is not NAME=POLICY or NAME=POLICY:TASK, such as mine=weights.safetensors:passage");
        let (name, policy) = text.split_once('=').ok_or_else(wrong)?;
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if name.is_empty() || name.len() > LONGEST || !name.chars().all(plain) {
            return Err(format!("the name '{name}' is not of 1 to {LONGEST} letters, digits, '-', '_' and '.'"));
        }
        // These name columns of the table, and what results are compared with.
        if KINDS.contains(&name) || name == REFERENCE {
            return Err(format!("the name '{name}' is taken; choose another one"));
        }
        // A path may contain a colon.
        let (policy, task) = match policy.rsplit_once(':') {
            Some((policy, task)) if !task.contains(['/', '.', '\\']) => (policy, Some(task)),
            _ => (policy, None),
        };
        if policy.is_empty() {
            return Err(wrong());
        }
        let known = |name: &str| {
            let names = TASKS.map(|task| task.name);
            let found = names.into_iter().find(|other| *other == name);
            found.ok_or_else(|| format!("there is no task '{name}'; there are: {}", names.join(", ")))
        };
        Ok(Entered { name: name.to_owned(), policy: policy.into(), task: task.map(known).transpose()? })
    }
}

impl fmt::Display for Entered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.policy.display())?;
        self.task.map_or(Ok(()), |task| write!(f, ":{task}"))
    }
}

/// Checks that each name is entered once for a task, and only for tasks that are run. An error names the flag.
pub fn check(entered: &[Entered], tasks: &[&Task]) -> Result<()> {
    for (at, one) in entered.iter().enumerate() {
        let same = |other: &&Entered| {
            other.name == one.name && (other.task.is_none() || one.task.is_none() || other.task == one.task)
        };
        if entered[..at].iter().any(|other| same(&other)) {
            return bad(format!("--enter: '{}' is entered twice for a task", one.name));
        }
        if let Some(task) = one.task.filter(|name| tasks.iter().all(|task| task.name != *name)) {
            return bad(format!("--enter {one}: the task '{task}' is not among those of --tasks"));
        }
    }
    Ok(())
}

/// Returns the names of the entered policies, each once, in their order.
pub fn names(entered: &[Entered]) -> Vec<String> {
    let first = |(at, one): &(usize, &Entered)| entered[..*at].iter().all(|other| other.name != one.name);
    entered.iter().enumerate().filter(first).map(|(_, one)| one.name.clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_is_entered_under_a_name_for_one_task_or_all() {
        let entered: Entered = "mine=runs/w.safetensors:passage".parse().expect("it is one");
        assert_eq!((&*entered.name, entered.task), ("mine", Some("passage")));
        assert_eq!(entered.policy, PathBuf::from("runs/w.safetensors"));
        assert_eq!(entered.to_string(), "mine=runs/w.safetensors:passage");
        let all: Entered = "theirs=C:\\w.onnx".parse().expect("it is one");
        assert_eq!((all.policy, all.task), (PathBuf::from("C:\\w.onnx"), None));
        for (wrong, says) in [
            ("mine", "is not NAME=POLICY"),
            ("mine=", "is not NAME=POLICY"),
            ("=orca", "the name '' is not of 1 to 32"),
            ("a,b=orca", "the name 'a,b' is not of"),
            ("scripted=orca", "the name 'scripted' is taken"),
            ("perfect=orca", "is taken"),
            ("mine=orca:chess", "there is no task 'chess'; there are: passage, swap,"),
        ] {
            let error = wrong.parse::<Entered>().expect_err(wrong);
            assert!(error.contains(says) && !error.contains('\n'), "{wrong}: {error}");
        }
    }

    #[test]
    fn one_name_may_have_a_policy_for_each_task_and_no_two_for_one() {
        let of = |values: &[&str]| values.iter().map(|text| text.parse().expect("it is one")).collect::<Vec<Entered>>();
        let tasks: Vec<&Task> = TASKS.iter().collect();
        let apart = of(&["a=orca:passage", "a=orca:swap", "b=orca"]);
        check(&apart, &tasks).expect("each task has one");
        assert_eq!(names(&apart), ["a", "b"]);
        for twice in [["a=orca:swap", "a=shipped:swap"], ["a=orca", "a=shipped:swap"]] {
            assert!(check(&of(&twice), &tasks).is_err_and(|error| error.to_string().contains("twice")), "{twice:?}");
        }
        let error = check(&of(&["a=orca:swap"]), &tasks[..1]).expect_err("swap is not run");
        assert!(error.to_string().contains("not among those of --tasks"), "{error}");
    }
}
