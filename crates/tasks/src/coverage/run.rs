//! Episodes of a team that a scripted controller drives over a ground, with their cost.

use super::{
    Point, baselines,
    cost::{cost, normalised},
    field::Field,
    rest::Places,
    seen::Seen,
    size::PUBLISHED,
};

/// Distance \[m\] from the rim of the ground at which a robot is stopped, as in CoverageControl (by experiment).
const RIM_M: f64 = 1e-4;

/// Parameters of robots and episodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Time of a step \[s\].
    pub step_s: f64,
    /// Largest speed of a robot \[m/s\].
    pub speed_m_s: f64,
    /// Distance \[m\] below which robots hear each other.
    pub communication_m: f64,
    /// Side \[m\] of the square around a robot that its local map covers.
    pub local_map_m: f64,
    /// Side \[m\] of the square around a robot that its sensor covers.
    pub sensor_m: f64,
    /// Rule for robots that come back to the same place.
    pub rest: Rest,
}

/// Rule for robots that come back to the same place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rest {
    /// They go on to their goals.
    Never,
    /// They rest by the rule of CoverageControl, [`Places::at_rest`].
    Places,
}

impl Parameters {
    /// Returns the parameters of the benchmark: robots of 5 m/s, communication to 128 m, local maps of 256 m and
    /// sensors of 64 m, which are defaults of CoverageControl 1.3.1, and steps of 0.2 s, where the default is 1 s.
    pub fn published() -> Parameters {
        Parameters {
            step_s: 0.2,
            speed_m_s: PUBLISHED.speed_m_s.into(),
            communication_m: PUBLISHED.communication_m.into(),
            local_map_m: PUBLISHED.local_map_m,
            sensor_m: PUBLISHED.sensor_m,
            rest: Rest::Places,
        }
    }
}

/// Kind of scripted controller, by what it knows: see [`baselines`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// Knows the whole density and all positions.
    Clairvoyant,
    /// Knows what the team has seen, and all positions.
    Centralised,
    /// Knows for each robot what it has seen, and the positions of its neighbours.
    Decentralised,
}

impl Baseline {
    /// All baselines, from the one that knows most.
    pub const ALL: [Baseline; 3] = [Baseline::Clairvoyant, Baseline::Centralised, Baseline::Decentralised];

    /// Returns the name of the baseline in tables.
    pub fn name(self) -> &'static str {
        match self {
            Baseline::Clairvoyant => "clairvoyant",
            Baseline::Centralised => "centralised",
            Baseline::Decentralised => "decentralised",
        }
    }
}

/// Team of robots in an episode, under a scripted controller.
#[derive(Clone, Debug)]
pub struct Team<'a> {
    field: &'a Field,
    parameters: Parameters,
    baseline: Baseline,
    robots: Vec<Point>,
    places: Vec<Places>,
    /// Sets of seen cells: none for the clairvoyant controller, one of the team, or one per robot.
    seen: Vec<Seen>,
    first_cost: f64,
}

impl<'a> Team<'a> {
    /// Makes a team at its start, where each robot has sensed once. `starts` are the places of the robots \[m\].
    ///
    /// # Panics
    /// If a place is not finite.
    pub fn new(field: &'a Field, parameters: Parameters, baseline: Baseline, starts: &[Point]) -> Team<'a> {
        assert!(starts.iter().flatten().all(|along| along.is_finite()), "a start is a place");
        let sets = match baseline {
            Baseline::Clairvoyant => 0,
            Baseline::Centralised => 1,
            Baseline::Decentralised => starts.len(),
        };
        let mut team = Team {
            field,
            parameters,
            baseline,
            robots: starts.to_vec(),
            places: vec![Places::default(); starts.len()],
            seen: vec![Seen::nothing(field.grid()); sets],
            first_cost: cost(field, starts),
        };
        team.sense();
        team
    }

    /// Returns the places of the robots \[m\].
    pub fn robots(&self) -> &[Point] {
        &self.robots
    }

    /// Returns the cost relative to that at the start.
    pub fn cost(&self) -> f64 {
        normalised(cost(self.field, &self.robots), self.first_cost)
    }

    /// Returns the goal of each robot \[m\].
    pub fn goals(&self) -> Vec<Point> {
        match self.baseline {
            Baseline::Clairvoyant => baselines::clairvoyant(self.field, &self.robots),
            Baseline::Centralised => baselines::centralised(self.field, &self.robots, &self.seen[0]),
            Baseline::Decentralised => {
                let goal = |(own, seen): (usize, &Seen)| {
                    let neighbours = self.neighbours(own);
                    let local_map_m = self.parameters.local_map_m;
                    baselines::decentralised(self.field, self.robots[own], &neighbours, seen, local_map_m)
                };
                self.seen.iter().enumerate().map(goal).collect()
            }
        }
    }

    /// Moves each robot for one step towards its goal. Returns whether a robot was moved; if not, the episode is over.
    pub fn step(&mut self) -> bool {
        let reach_m = self.parameters.speed_m_s * self.parameters.step_s;
        let mut moved = false;
        for (at, goal) in self.goals().into_iter().enumerate() {
            let from = self.robots[at];
            let way = [goal[0] - from[0], goal[1] - from[1]];
            let distance_m = libm::hypot(way[0], way[1]);
            let rests = self.parameters.rest == Rest::Places && self.places[at].at_rest();
            let mut to = from;
            if !rests && distance_m > 0.0 {
                moved = true;
                let share = (reach_m / distance_m).min(1.0);
                to = [from[0] + way[0] * share, from[1] + way[1] * share];
            }
            self.robots[at] = self.field.grid().inside(to, RIM_M);
            self.places[at].add(self.robots[at]);
        }
        self.sense();
        moved
    }

    /// Returns the places of the other robots within communication range of the robot with the index `own`.
    fn neighbours(&self, own: usize) -> Vec<Point> {
        let from = self.robots[own];
        let near = |at: &Point| libm::hypot(at[0] - from[0], at[1] - from[1]) < self.parameters.communication_m;
        let others = self.robots.iter().enumerate().filter(|(at, _)| *at != own);
        others.map(|(_, place)| *place).filter(near).collect()
    }

    /// Adds what the robots' sensors cover to what has been seen.
    fn sense(&mut self) {
        let sets = self.seen.len();
        if sets == 0 {
            return;
        }
        for (at, &robot) in self.robots.iter().enumerate() {
            let window = self.field.grid().window(robot, self.parameters.sensor_m);
            self.seen[at.min(sets - 1)].look(&window);
        }
    }
}

/// Result of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Mean of the cost over all steps, relative to that at the start. A cost holds until the next one is computed, and
    /// the last one until the end.
    pub mean: f64,
    /// Last cost, relative to that at the start.
    pub last: f64,
    /// Number of steps until all robots rested, or of the whole episode.
    pub steps: usize,
}

/// Drives a team for at most `steps` steps, and computes its cost after the first of each `cost_every` steps.
///
/// # Panics
/// If `steps` or `cost_every` is zero.
pub fn run(mut team: Team, steps: usize, cost_every: usize) -> Outcome {
    assert!(steps > 0 && cost_every > 0, "an episode has steps, and a cost in some of them");
    let (mut sum, mut last) = (0.0, 1.0);
    for step in 0..steps {
        let moved = team.step();
        if step % cost_every == 0 || !moved {
            last = team.cost();
        }
        sum += last;
        if !moved {
            sum += last * (steps - 1 - step) as f64;
            return Outcome { mean: sum / steps as f64, last, steps: step + 1 };
        }
    }
    Outcome { mean: sum / steps as f64, last, steps }
}

#[cfg(test)]
mod tests {
    use murmurate::random::Seed;

    use super::*;
    use crate::coverage::{
        field::{Bounds, place},
        grid::Grid,
    };

    const GRID: Grid = Grid { cells: 256, cell_m: 4.0 };

    fn world(seed: u64) -> (Field, Vec<Point>) {
        let mut stream = Seed::of_run(seed).stream("coverage/world");
        let features = Bounds::published().draw(GRID, &mut stream);
        let field = Field::of_features(GRID, &features, 2.0).expect("Gaussians");
        (field, (0..32).map(|_| place(GRID, &mut stream)).collect())
    }

    #[test]
    fn who_knows_more_covers_better() {
        let (field, starts) = world(1);
        let outcome = |baseline| run(Team::new(&field, Parameters::published(), baseline, &starts), 300, 10);
        let [clairvoyant, centralised, decentralised] = Baseline::ALL.map(outcome);
        assert!(clairvoyant.mean < centralised.mean && centralised.mean < decentralised.mean);
        assert!(decentralised.last < 1.0 && clairvoyant.last < 0.5, "{clairvoyant:?} {decentralised:?}");
        assert_eq!(Baseline::ALL.map(outcome), [clairvoyant, centralised, decentralised]);
    }

    #[test]
    fn a_step_is_at_most_as_long_as_the_speed_allows_and_stays_on_the_ground() {
        let (field, mut starts) = world(2);
        starts[0] = [-40.0, 2000.0];
        let mut team = Team::new(&field, Parameters::published(), Baseline::Clairvoyant, &starts);
        for _ in 0..20 {
            let before = team.robots().to_vec();
            team.step();
            for (from, to) in before.iter().zip(team.robots()).skip(1) {
                assert!(libm::hypot(to[0] - from[0], to[1] - from[1]) <= 1.0 + 1e-9);
            }
            assert!(team.robots().iter().flatten().all(|along| (0.0..1024.0).contains(along)));
        }
    }

    #[test]
    fn an_empty_field_costs_1_and_robots_come_to_rest() {
        let field = Field::of_cells(GRID, vec![0.0; 256 * 256]).expect("a density");
        let team = Team::new(&field, Parameters::published(), Baseline::Decentralised, &[[512.0, 500.0]]);
        assert_eq!(run(team, 50, 10), Outcome { mean: 1.0, last: 1.0, steps: 1 });
    }
}
