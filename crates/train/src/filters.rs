//! Safety filters of the robots in training environments: those of real robots, with the drives of each episode.

use super::conditions::EpisodeConditions;
use murmurate::safety::Safety;
use murmurate::safety::filter::{Filter, Settings};
use murmurate::safety::yielding::Yielding;
use murmurate::scenario::Arena;
use murmurate::world::Physics;
use murmurate::world::kinematic::{MAX_SPEED_M_S, PERIOD};

/// Returns the safety filter of a robot in an episode with the conditions `episode`; `None` if robots have no filter in
/// it. The commanded points of all robots are `ahead_m` \[m\] ahead of their centres.
pub fn filter(episode: &EpisodeConditions, arena: &Arena, physics: &Physics, ahead_m: f32) -> Option<Filter> {
    episode.filtered.then(|| {
        Filter::new(Settings {
            safety: physics.fit(Safety::filter().of_hull(arena.hull_m())).about_point(ahead_m, ahead_m),
            half_extent: arena.half_extent.add_scalar(-ahead_m),
            walls: arena.keep_outs.as_slice().into(),
            movers: arena.movers.as_slice().into(),
            limit_m_s: MAX_SPEED_M_S,
            clamp: episode.clamp,
            period: PERIOD,
        })
    })
}

/// Returns, for a checkpoint, the state of each robot's safety filter that lasts from step to step (its way out of
/// deadlocks); the initial state for a robot without a filter.
pub fn yielding(filters: &[Option<Filter>]) -> Vec<Yielding> {
    filters.iter().map(|filter| filter.as_ref().map(Filter::yielding).unwrap_or_default()).collect()
}

/// Restores the states of safety filters, one per robot, that the function `yielding` has returned.
pub fn restore(filters: &mut [Option<Filter>], yielding: &[Yielding]) {
    for (filter, yielding) in filters.iter_mut().zip(yielding) {
        filter.iter_mut().for_each(|filter| filter.restore(*yielding));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::environments::Environments;
    use murmurate::messages::geometry::Vec2;
    use murmurate::random::Seed;
    use murmurate::safety::Clamp;
    use murmurate::scenario::{self, Settings};

    /// Whether robots that drive at their nearest neighbour touch anything in ten seconds.
    fn touched(filtered: bool, lockstep: bool) -> bool {
        let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
        let weights = Config::preset("robust").expect("it is built in").reward;
        let mut stream = Seed::of_run(5).stream("filters");
        let mut environments = Environments::new(1, &[vec![5]], &[passage]);
        let (lag_s, clamp) = (Some(0.5), Clamp::Deployed);
        let hold_s = 0.4;
        let episode = EpisodeConditions {
            lockstep,
            filtered,
            lag_s,
            clamp,
            hold_s,
            wall_radius_m: 0.16,
            ..EpisodeConditions::perfect(5)
        };
        environments.place(0, (3, 0), episode.clone(), &mut stream);
        for step in 0..200 {
            let mut messages = std::mem::take(&mut environments.teams[0].messages);
            for receiver in 0..5 {
                messages.receive((&episode, 2.0), (step, 0), receiver, &mut stream, |_, _| {});
            }
            environments.teams[0].messages = messages;
            let at = environments.position.clone();
            let nearest = |own: Vec2| {
                let others = at.iter().filter(|other| **other != own);
                *others.min_by(|a, b| (**a - own).norm().total_cmp(&(**b - own).norm())).expect("there are others")
            };
            let actions: Vec<Vec2> = at.iter().map(|own| (nearest(*own) - *own) * 9.0).collect();
            environments.step(0, &actions, &weights, 1.5, &mut stream);
        }
        environments.teams[0].touched
    }

    #[test]
    fn in_a_filtered_episode_no_action_makes_robots_touch() {
        for lockstep in [true, false] {
            assert!(touched(false, lockstep), "without the filter, lock step {lockstep}");
            assert!(!touched(true, lockstep), "with the filter, lock step {lockstep}");
        }
    }
}
