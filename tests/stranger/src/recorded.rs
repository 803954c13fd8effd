//! Episodes of JaxMARL's environment under random actions, which `examples/others/jaxmarl/reference.py` has recorded.

use murmurate::messages::geometry::{Motion, Vec2};
use serde::Deserialize;

#[derive(Deserialize)]
struct Recorded {
    episodes: Vec<Episode>,
}

/// Episode: its landmarks, and the states of the robots before it and after each step.
#[derive(Deserialize)]
pub struct Episode {
    /// Positions of the landmarks.
    pub landmarks: Vec<[f32; 2]>,
    /// State before the first step, then one for each step.
    pub steps: Vec<Step>,
}

/// State after a step, with the actions and the reward of the step.
#[derive(Deserialize)]
pub struct Step {
    position: Vec<[f32; 2]>,
    velocity: Vec<[f32; 2]>,
    #[serde(default)]
    actions: Vec<usize>,
    /// Sum of the rewards of all robots.
    #[serde(default)]
    pub reward: f64,
}

impl Step {
    /// Returns the motion of each robot.
    pub fn motions(&self) -> Vec<Motion> {
        let motion = |(position, velocity): (&[f32; 2], &[f32; 2])| Motion {
            position: Vec2::from(*position),
            velocity: Vec2::from(*velocity),
        };
        self.position.iter().zip(&self.velocity).map(motion).collect()
    }

    /// Returns the force that each robot's action stands for.
    pub fn forces(&self) -> Vec<Vec2> {
        let all = [[0.0, 0.0], [-5.0, 0.0], [5.0, 0.0], [0.0, -5.0], [0.0, 5.0]];
        self.actions.iter().map(|action| Vec2::from(all[*action])).collect()
    }
}

/// Returns all episodes.
pub fn episodes() -> Vec<Episode> {
    let text = include_str!("../data/spread.json");
    serde_json::from_str::<Recorded>(text).expect("a record of episodes").episodes
}
