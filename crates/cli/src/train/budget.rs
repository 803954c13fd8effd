//! Length of a training: minutes of real time, everything that `train` does included, or decisions.

use std::time::Instant;

use anyhow::Result;

use super::Args;
use murmurate_robot::BadInput;

/// Length of a training: minutes of real time, or number of decisions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// Time from the start of the command to its end \[min\], with all evaluations and files.
    Minutes(f64),
    /// Number of decisions, however long they take.
    Decisions(u64),
}

impl Budget {
    /// Returns the budget that the flags state. An error names the flag.
    pub fn of(args: &Args) -> Result<Budget> {
        match (args.minutes, args.steps) {
            (Some(minutes), _) if (1e-3..=1e6).contains(&minutes) => Ok(Budget::Minutes(minutes)),
            (Some(minutes), _) => Err(BadInput(format!("--minutes: {minutes} is not 0.001 to 1000000")).into()),
            (_, Some(0)) => Err(BadInput("--steps: 0 is not above 0".to_owned()).into()),
            (_, Some(decisions)) => Ok(Budget::Decisions(decisions)),
            _ => Err(BadInput("the length of the training is missing; give --minutes or --steps".to_owned()).into()),
        }
    }
}

/// What is left of a budget: the share of the training that is done, with room for what comes after it.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    budget: Budget,
    /// Longest time that one of each has taken so far \[s\], in the order of `Timed`.
    longest_s: [f64; 4],
    progress: f64,
}

/// What is timed, because one more of it may come before the end.
#[derive(Clone, Copy, Debug)]
pub enum Timed {
    /// One iteration of the training.
    Iteration,
    /// One evaluation of the policy on its way.
    Glance,
    /// The evaluation at the end.
    Evaluation,
    /// Saving of all files.
    Save,
}

impl Clock {
    /// Returns the clock at the beginning of a training.
    pub fn new(budget: Budget) -> Clock {
        Clock { budget, longest_s: [0.0; 4], progress: 0.0 }
    }

    /// Notes how long something took \[s\].
    pub fn took(&mut self, what: Timed, took_s: f64) {
        let longest = &mut self.longest_s[what as usize];
        *longest = longest.max(took_s);
    }

    /// Runs something, and notes how long it took.
    pub fn time<T>(&mut self, what: Timed, run: impl FnOnce() -> T) -> T {
        let began = Instant::now();
        let done = run();
        self.took(what, began.elapsed().as_secs_f64());
        done
    }

    /// Returns the share of the training that is done, after a duration `elapsed_s` \[s\] and `trained` decisions; 1 or
    /// more at its end. With a budget of minutes the training ends early enough for one more iteration, evaluation and
    /// save, as long as the longest of each so far. The share never falls.
    pub fn progress(&mut self, elapsed_s: f64, trained: u64) -> f64 {
        let now = match self.budget {
            Budget::Minutes(minutes) => {
                let [iteration_s, glance_s, evaluation_s, save_s] = self.longest_s;
                // Files may be saved after the iteration, and are before and after the evaluation at the end.
                let after_s = iteration_s + glance_s + evaluation_s + 3.0 * save_s;
                // The first iteration is made, however short the time is.
                let for_training_s = 60.0 * minutes - if iteration_s > 0.0 { after_s } else { 0.0 };
                if elapsed_s >= for_training_s { 1.0 } else { elapsed_s / for_training_s }
            }
            Budget::Decisions(decisions) => trained as f64 / decisions as f64,
        };
        self.progress = self.progress.max(now);
        self.progress
    }

    /// Whether the budget is one of minutes.
    pub fn counts_minutes(&self) -> bool {
        matches!(self.budget, Budget::Minutes(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs a training whose iterations, evaluations (an eighth of one after every twentieth of it, and one at the end)
    /// and saves take these times; returns when it ends, and how many iterations it had.
    fn ends_at(minutes: f64, [iteration_s, evaluation_s, save_s]: [f64; 3]) -> (f64, u32) {
        let (mut clock, mut now_s, mut iterations, mut evaluated) = (Clock::new(Budget::Minutes(minutes)), 0.0, 0, 0);
        clock.took(Timed::Evaluation, evaluation_s);
        loop {
            let progress = clock.progress(now_s, 0);
            if progress >= 1.0 {
                break;
            }
            iterations += 1;
            for (what, took_s, due) in [
                (Timed::Iteration, iteration_s, true),
                (Timed::Glance, evaluation_s / 8.0, (20.0 * progress) as u32 > evaluated),
                (Timed::Save, save_s, iterations % 10 == 1),
            ] {
                if due {
                    now_s += took_s;
                    clock.took(what, took_s);
                }
            }
            evaluated = (20.0 * progress) as u32;
        }
        (now_s + evaluation_s + 2.0 * save_s, iterations)
    }

    #[test]
    fn a_training_of_minutes_ends_within_them_with_its_last_evaluation() {
        for (minutes, times) in
            [(5.0, [0.4, 18.0, 0.2]), (5.0, [2.0, 1.0, 3.0]), (20.0, [0.3, 25.0, 0.1]), (1.0, [0.5, 6.0, 0.1])]
        {
            let (end_s, iterations) = ends_at(minutes, times);
            assert!(end_s <= 60.0 * minutes, "{minutes} min, {times:?}: {end_s} s");
            let unused_s = 60.0 * minutes - end_s;
            assert!(
                unused_s <= 2.0 * times[0] + times[1] / 8.0 + 3.0 * times[2],
                "{minutes} min, {times:?}: {unused_s} s unused"
            );
            assert!(iterations > 5, "{iterations}");
        }
    }

    #[test]
    fn a_budget_that_is_too_short_for_an_evaluation_still_trains_once() {
        let (_, iterations) = ends_at(0.001, [1.0, 5.0, 0.1]);
        assert_eq!(iterations, 1);
        let mut clock = Clock::new(Budget::Decisions(100));
        clock.took(Timed::Evaluation, 1e6);
        assert_eq!((clock.progress(1e9, 50), clock.progress(1e9, 100)), (0.5, 1.0));
    }
}
