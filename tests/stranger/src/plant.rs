//! The plant `glide`: points that follow their commands with a lag, pass through each other, and stop at the edge. The
//! judge still measures their distances.

use murmurate::chassis::DriveKind;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::random::Seed;
use murmurate::scenario::Arena;
use murmurate::time::Span;
use murmurate::world::{Entry, Physics, Plant, PlantState};

/// Entry in a registry.
pub const GLIDE: Entry = Entry {
    name: "glide",
    about: "points that follow their commands with a lag",
    physics: |arena| Physics { lag_s: 0.1, ..Physics::published(arena) },
    fixed: &[("contacts", "points in plant 'glide' pass through each other")],
    drives: &[DriveKind::Holonomic],
    build,
};

const PERIOD: Span = Span::from_millis(50);

struct Glide {
    half_extent: Vec2,
    /// Share of a change of velocity that one step makes.
    gain: f32,
    commands: Vec<Vec2>,
    states: Vec<PlantState>,
}

fn build(arena: &Arena, physics: &Physics, positions: &[Vec2], _: Seed) -> Box<dyn Plant> {
    let at_rest = |position: &Vec2| PlantState { motion: Motion::at_rest(*position), ..PlantState::default() };
    Box::new(Glide {
        half_extent: arena.half_extent,
        gain: physics.gain(PERIOD),
        commands: vec![Vec2::zeros(); positions.len()],
        states: positions.iter().map(at_rest).collect(),
    })
}

impl Plant for Glide {
    fn period(&self) -> Span {
        PERIOD
    }

    fn place(&mut self, robot: usize, position: Vec2, _: f32) {
        self.commands[robot] = Vec2::zeros();
        self.states[robot].motion = Motion::at_rest(position);
    }

    fn drive(&mut self, robot: usize, velocity: Vec2) {
        self.commands[robot] = velocity;
    }

    fn advance(&mut self) {
        for (PlantState { motion, .. }, command) in self.states.iter_mut().zip(&self.commands) {
            motion.velocity += (command - motion.velocity) * self.gain;
            let wanted = motion.position + motion.velocity * PERIOD.as_secs() as f32;
            motion.position = wanted.sup(&-self.half_extent).inf(&self.half_extent);
        }
    }

    fn states(&self) -> &[PlantState] {
        &self.states
    }
}
