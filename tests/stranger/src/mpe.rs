//! The plant `mpe`: points of mass 1 that are pushed by forces and damped, and push each other away.
//!
//! They are the particles of JaxMARL's environments (`jaxmarl/environments/mpe/simple.py`, after Lowe et al., NeurIPS
//! 2017, arXiv 1706.02275).
//!
//! A command is a velocity, as in every plant. The force is what would change the robot's velocity to it within a step,
//! at most 5 along each axis. So a policy that commands accelerations at the rate of the plant gives the force.

use murmurate::chassis::DriveKind;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::random::Seed;
use murmurate::scenario::Arena;
use murmurate::time::Span;
use murmurate::world::{Entry, Physics, Plant, PlantState};

/// Entry in a registry.
pub const MPE: Entry = Entry {
    name: "mpe",
    about: "particles of JaxMARL's MPE environments: forces, damping, soft contacts",
    physics: Physics::published,
    fixed: &[
        ("contacts", "particles of plant 'mpe' push each other"),
        ("lag_s", "particles of plant 'mpe' have no lag"),
    ],
    drives: &[DriveKind::Holonomic],
    build,
};

/// Largest force along each axis \[N\]: `accel`.
const FORCE: f32 = 5.0;
/// Duration of a step: `DT` of MPE.
pub const PERIOD: Span = Span::from_millis(100);
/// Share of the velocity that is lost in a step: `DAMPING`.
const DAMPING: f32 = 0.25;
/// Factor of the force between two particles \[N/m\]: `CONTACT_FORCE`.
const CONTACT_FORCE: f32 = 100.0;
/// Softness of their surfaces \[m\]: `CONTACT_MARGIN`.
const CONTACT_MARGIN: f32 = 1e-3;
/// Distance of two centres below which particles touch \[m\]: twice their radius of 0.15 m.
pub const TOUCH_M: f32 = 0.3;

struct Particles {
    commands: Vec<Vec2>,
    states: Vec<PlantState>,
}

fn build(_: &Arena, _: &Physics, positions: &[Vec2], _: Seed) -> Box<dyn Plant> {
    let at_rest = |position: &Vec2| PlantState { motion: Motion::at_rest(*position), ..PlantState::default() };
    let commands = vec![Vec2::zeros(); positions.len()];
    Box::new(Particles { commands, states: positions.iter().map(at_rest).collect() })
}

/// Returns the force on the particle at `own` from the one at `other` \[N\].
fn contact(own: Vec2, other: Vec2) -> Vec2 {
    let between = own - other;
    let distance = between.norm();
    let depth = -(distance - TOUCH_M) / CONTACT_MARGIN;
    // The softened positive part of the depth: log(1 + exp(depth)), without overflow.
    let soft = depth.max(0.0) + (-depth.abs()).exp().ln_1p();
    between * (CONTACT_FORCE / distance * soft * CONTACT_MARGIN)
}

impl Plant for Particles {
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
        let dt = PERIOD.as_secs() as f32;
        let before: Vec<Motion> = self.states.iter().map(|state| state.motion).collect();
        for (robot, (state, command)) in self.states.iter_mut().zip(&self.commands).enumerate() {
            let own = before[robot];
            let others = before.iter().enumerate().filter(|(other, _)| *other != robot);
            let pushed = others.fold(Vec2::zeros(), |sum, (_, other)| sum + contact(own.position, other.position));
            let wanted = ((command - own.velocity) / dt).map(|axis| axis.clamp(-FORCE, FORCE));
            state.motion = Motion {
                position: own.position + own.velocity * dt,
                velocity: own.velocity * (1.0 - DAMPING) + (wanted + pushed) * dt,
            };
        }
    }

    fn states(&self) -> &[PlantState] {
        &self.states
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorded;

    #[test]
    fn it_moves_as_the_environment_of_jaxmarl() {
        for (index, episode) in recorded::episodes().iter().enumerate() {
            let arena = crate::spread::arena();
            let starts = episode.steps[0].motions();
            let positions: Vec<Vec2> = starts.iter().map(|motion| motion.position).collect();
            let mut plant = build(&arena, &(MPE.physics)(&arena), &positions, Seed::of_run(0));
            let mut worst = 0.0_f32;
            for step in &episode.steps[1..] {
                for (robot, force) in step.forces().into_iter().enumerate() {
                    let velocity = plant.states()[robot].motion.velocity;
                    plant.drive(robot, velocity + force * PERIOD.as_secs() as f32);
                }
                plant.advance();
                for (state, motion) in plant.states().iter().zip(step.motions()) {
                    worst = worst.max((state.motion.position - motion.position).amax());
                    worst = worst.max((state.motion.velocity - motion.velocity).amax());
                }
            }
            assert!(worst <= 1e-5, "episode {index} is {worst:e} apart after 25 steps");
        }
    }
}
