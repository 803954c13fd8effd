//! A simulated world of rigid bodies: discs with mass and friction, driven by drivetrains with lag and slip. Robots
//! push each other, and walls block them. Contacts are flagged for the judge and do not end the simulation.
//!
//! The solver is the library rapier in its deterministic mode, which gives the same result on every platform. Its
//! vector type is used in this file only.

use std::collections::BTreeMap;

use rapier2d::prelude::{
    ColliderBuilder, ColliderHandle, IntegrationParameters, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle,
    RigidBodyType, Vector,
};

use super::drivetrain::{Drivetrain, StepParameters, limit_norm};
use super::kinematic::PERIOD;
use super::{Physics, Plant, PlantState, Wheels};
use crate::chassis::Chassis;
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::{Arena, KeepOut, Solid};
use crate::time::Span;

/// Fields of `Overrides` that a user may not set for the rigid-body plant: pairs of the field's name and the reason.
pub const FIXED: &[(&str, &str)] = &[
    ("contacts", "in plant 'rigid' bodies always push each other, and contacts are flagged for the judge"),
    ("wall_radius_m", "in plant 'rigid' the radius of a robot is that of its hull, hull_m or 0.16 m"),
];

/// Thickness of the rails around the ground \[m\]: more than a robot moves in any step.
const RAIL_M: f32 = 1.0;

/// Depth to which a robot that pushes against a rail may sink into it \[m\].
const SINK_M: f32 = 0.002;

/// Simulated world of rigid bodies as a plant: robots are discs with mass, friction and slipping wheels.
pub struct Rigid {
    arena: Arena,
    physics: Physics,
    world: PhysicsWorld,
    parameters: StepParameters,
    /// Colliders of the solid blocks of the arena.
    blocks: Vec<ColliderHandle>,
    /// Bodies of its moving obstacles, each as long as an episode runs.
    movers: Vec<RigidBodyHandle>,
    /// Time since the episode runs at the end of the next step; `None` while none runs.
    elapsed: Option<Span>,
    robots: Vec<(RigidBodyHandle, Drivetrain)>,
    /// Wheels of robots that are not holonomic without limits of their own.
    wheels: BTreeMap<usize, Wheels>,
    states: Vec<PlantState>,
}

/// Makes the rigid-body world of `arena` with one robot at rest at each of `positions` \[m\], world frame. `physics`
/// has the parameters of the robots. The wheel slip of each robot is drawn from a random stream of its own, derived
/// from `seed`.
pub fn build(arena: &Arena, physics: &Physics, positions: &[Vec2], seed: Seed) -> Box<dyn Plant> {
    let period_s = PERIOD.as_secs() as f32;
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::ZERO;
    // One step a period, which the solver divides into four substeps. The prediction distance covers the motion of a
    // whole step. So any two bodies that can collide within it, also if pushed by a third, are contact pairs at its
    // start. Therefore continuous collision detection and the reuse of the last step's contacts are off.
    world.integration_parameters = IntegrationParameters {
        dt: period_s,
        normalized_prediction_distance: 2.0 * physics.top_speed_m_s * period_s,
        max_ccd_substeps: 0,
        contact_recycling: false,
        num_internal_pgs_iterations: 4,
        ..IntegrationParameters::default()
    };
    let core_m = physics.wall_radius_m - physics.give_m;
    let blocks = insert_blocks(&mut world, physics, &arena.keep_outs);
    // A robot's solid core touches the rails just before its centre leaves the ground.
    let face = arena.half_extent.add_scalar(core_m - SINK_M);
    let (half, reach) = (face.add_scalar(RAIL_M), face.add_scalar(RAIL_M / 2.0));
    for side in [-1.0, 1.0] {
        let (upright, level) = (Vec2::new(RAIL_M / 2.0, half.y), Vec2::new(half.x, RAIL_M / 2.0));
        world.insert_collider(wall(physics, upright, Vec2::new(side * reach.x, 0.0)), None);
        world.insert_collider(wall(physics, level, Vec2::new(0.0, side * reach.y)), None);
    }
    let robots = positions.iter().enumerate().map(|(robot, position)| {
        // The robots hold their headings themselves, so rotation is not simulated.
        let body = RigidBodyBuilder::dynamic().translation(to_glam(*position)).lock_rotations().can_sleep(false);
        let disc = ColliderBuilder::ball(core_m).mass(physics.mass_kg);
        let (handle, _) = world.insert(body, disc.friction(physics.friction).restitution(physics.restitution));
        (handle, Drivetrain::new(seed.stream(&format!("slip/{robot}"))))
    });
    let robots = robots.collect();
    let mut plant = Rigid {
        arena: arena.clone(),
        physics: *physics,
        world,
        parameters: StepParameters::new(physics, PERIOD),
        blocks,
        movers: Vec::new(),
        elapsed: None,
        robots,
        wheels: BTreeMap::new(),
        states: vec![PlantState::default(); positions.len()],
    };
    plant.update_motion();
    Box::new(plant)
}

/// Returns the collider of a wall with half its size and its centre \[m\], world frame.
fn wall(physics: &Physics, half: Vec2, centre: Vec2) -> ColliderBuilder {
    let collider = ColliderBuilder::cuboid(half.x, half.y).translation(to_glam(centre));
    collider.friction(physics.friction).restitution(physics.restitution)
}

/// Returns the collider of a block that stands.
fn collider(physics: &Physics, block: &KeepOut) -> ColliderBuilder {
    let centre = (block.max + block.min) / 2.0;
    let about_centre = |corner: Vec2| to_glam(corner - centre);
    let shape = match block.solid() {
        Solid::Rect(_) => return wall(physics, (block.max - block.min) / 2.0, centre),
        Solid::Disc { disc: [.., radius_m] } => ColliderBuilder::ball(radius_m),
        Solid::Polygon { .. } => {
            let corners: Vec<Vector> = block.corners().map(about_centre).collect();
            ColliderBuilder::convex_hull(&corners).expect("a convex polygon has an area")
        }
    };
    shape.translation(to_glam(centre)).friction(physics.friction).restitution(physics.restitution)
}

fn insert_blocks(world: &mut PhysicsWorld, physics: &Physics, blocks: &[KeepOut]) -> Vec<ColliderHandle> {
    blocks.iter().map(|block| world.insert_collider(collider(physics, block), None)).collect()
}

impl Rigid {
    fn update_motion(&mut self) {
        for ((handle, _), state) in self.robots.iter().zip(&mut self.states) {
            let body = &self.world.bodies[*handle];
            state.motion.position = from_glam(body.translation());
            state.motion.velocity = from_glam(body.linvel());
        }
        for (robot, wheels) in &self.wheels {
            (self.states[*robot].heading, self.states[*robot].yaw_rate) = (wheels.heading(), wheels.yaw_rate());
        }
    }

    /// Updates the contact flags from the distances between hulls, as under `ContactRule::Judge`. The rails do not
    /// count as walls.
    fn update_contacts(&mut self) {
        let radius_m = self.physics.wall_radius_m;
        let arena = self.arena.at(self.elapsed);
        for robot in 0..self.states.len() {
            let at = self.states[robot].motion.position;
            let near = |(other, state): (usize, &PlantState)| {
                other != robot && (state.motion.position - at).norm() <= 2.0 * radius_m
            };
            let touches = self.states.iter().enumerate().any(near);
            self.states[robot].contacts = Contacts { robot: touches, wall: arena.clearance(at) <= radius_m };
        }
    }
}

impl Rigid {
    /// Moves the moving obstacles in the next step to where they are at its end. Robots push none of them.
    fn move_movers(&mut self) {
        let Some(elapsed) = self.elapsed else {
            for body in self.movers.drain(..) {
                self.world.remove_body(body);
            }
            return;
        };
        let places = self.arena.movers.iter().map(|mover| to_glam(mover.disc(elapsed).0.position));
        if self.movers.is_empty() {
            for (mover, place) in self.arena.movers.iter().zip(places) {
                let body = RigidBodyBuilder::kinematic_position_based().translation(place);
                let shape = collider(&self.physics, &mover.block(elapsed)).translation(Vector::ZERO);
                self.movers.push(self.world.insert(body, shape).0);
            }
            return;
        }
        for (body, place) in self.movers.iter().zip(places) {
            self.world.bodies[*body].set_next_kinematic_translation(place);
        }
    }
}

impl Plant for Rigid {
    fn period(&self) -> Span {
        PERIOD
    }

    fn equip(&mut self, robot: usize, chassis: Chassis, heading: f32) {
        self.wheels.insert(robot, Wheels::new(chassis, heading));
        self.update_motion();
    }

    fn place(&mut self, robot: usize, position: Vec2, heading: f32) {
        if let Some(wheels) = self.wheels.get_mut(&robot) {
            wheels.place(heading);
        }
        let (handle, drivetrain) = &mut self.robots[robot];
        drivetrain.command = Vec2::zeros();
        let body = &mut self.world.bodies[*handle];
        body.set_translation(to_glam(position), true);
        body.set_linvel(Vector::ZERO, true);
        self.states[robot].contacts = Contacts::default();
        self.update_motion();
    }

    fn launch(&mut self, robot: usize, velocity: Vec2) {
        let (handle, drivetrain) = &mut self.robots[robot];
        drivetrain.command = velocity;
        self.world.bodies[*handle].set_linvel(to_glam(velocity), true);
        self.update_motion();
    }

    fn enter(&mut self, arena: &Arena) -> bool {
        for block in std::mem::take(&mut self.blocks) {
            self.world.remove_collider(block);
        }
        self.blocks = insert_blocks(&mut self.world, &self.physics, &arena.keep_outs);
        for body in self.movers.drain(..) {
            self.world.remove_body(body);
        }
        self.arena.clone_from(arena);
        true
    }

    fn elapse(&mut self, elapsed: Option<Span>) -> bool {
        self.elapsed = elapsed;
        true
    }

    fn drive(&mut self, robot: usize, velocity: Vec2) {
        self.robots[robot].1.command = velocity;
    }

    fn carry(&mut self, robot: usize, motion: Motion, heading: f32) {
        let body = &mut self.world.bodies[self.robots[robot].0];
        // A kinematic body pushes the others and is pushed by none of them.
        body.set_body_type(RigidBodyType::KinematicVelocityBased, true);
        body.set_translation(to_glam(motion.position), true);
        body.set_linvel(to_glam(motion.velocity), true);
        self.states[robot].heading = heading;
        self.update_motion();
    }

    fn advance(&mut self) {
        if !self.arena.movers.is_empty() {
            self.move_movers();
        }
        let force = self.physics.mass_kg / PERIOD.as_secs() as f32;
        for (robot, (handle, drivetrain)) in self.robots.iter_mut().enumerate() {
            let body = &mut self.world.bodies[*handle];
            if body.is_kinematic() {
                continue;
            }
            let velocity = from_glam(body.linvel());
            let change = match self.wheels.get_mut(&robot) {
                None => drivetrain.velocity_change(&self.parameters, velocity),
                Some(wheels) => {
                    let point = wheels.point(&Motion { position: Vec2::zeros(), velocity }).velocity;
                    let point = point + drivetrain.velocity_change(&self.parameters, point);
                    wheels.drive(point, PERIOD.as_secs() as f32);
                    // On a curve the centre is accelerated more than the point; tyres slide where that is too much.
                    limit_norm(wheels.velocity() - velocity, self.parameters.total_change_m_s)
                }
            };
            body.reset_forces(false);
            // A force over the whole step instead of an impulse at its start, so that acceleration is steady.
            body.add_force(to_glam(change * force), false);
        }
        self.world.step();
        self.update_motion();
        self.update_contacts();
    }

    fn states(&self) -> &[PlantState] {
        &self.states
    }
}

fn to_glam(v: Vec2) -> Vector {
    Vector::new(v.x, v.y)
}

fn from_glam(v: Vector) -> Vec2 {
    Vec2::new(v.x, v.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build as scenario};

    const HULL_M: f32 = 0.16;

    fn arena() -> Arena {
        scenario("passage", &Settings::default()).unwrap().arena().clone()
    }

    /// The robots of the data sheet, with prompt wheels that do not slip.
    fn prompt() -> Physics {
        Physics { slip: 0.0, lag_s: 0.0, acceleration_m_s2: f32::INFINITY, ..Physics::robomaster(&arena()) }
    }

    fn plant(physics: &Physics, positions: &[Vec2]) -> Box<dyn Plant> {
        build(&arena(), physics, positions, Seed::of_run(7))
    }

    fn drive_all(plant: &mut dyn Plant, commands: &[Vec2], steps: usize, mut see: impl FnMut(&[PlantState])) {
        for _ in 0..steps {
            commands.iter().enumerate().for_each(|(robot, command)| plant.drive(robot, *command));
            plant.advance();
            see(plant.states());
        }
    }

    #[test]
    fn a_single_robot_follows_its_drivetrain() {
        let physics = Physics { lag_s: 0.5, ..prompt() };
        let mut plant = plant(&physics, &[Vec2::new(-1.5, -2.5)]);
        let mut step = 0;
        drive_all(&mut *plant, &[Vec2::new(1.0, 0.5)], 40, |states| {
            step += 1;
            let (t, motion) = (step as f32 * 0.05, states[0].motion);
            let share = 1.0 - (-t / 0.5).exp();
            assert!((motion.velocity - Vec2::new(1.0, 0.5) * share).norm() < 1e-4, "{t} s: {motion:?}");
            // The integral of that, up to the error of the solver's four substeps.
            let path = Vec2::new(1.0, 0.5) * (t - 0.5 * share);
            assert!((motion.position - Vec2::new(-1.5, -2.5) - path).norm() < 0.012, "{t} s: {motion:?}");
        });
    }

    #[test]
    fn the_point_of_a_differential_robot_goes_where_that_of_a_holonomic_one_goes() {
        use crate::chassis::{DriveKind, Settings as Drive};
        let drive = Drive { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Drive::default() };
        let physics = Physics { lag_s: 0.3, acceleration_m_s2: 1.0, ..prompt() };
        let mut wheels = plant(&physics, &[Vec2::new(-1.5, -2.5)]);
        wheels.equip(0, drive.chassis().unwrap(), 0.0);
        let mut other = plant(&physics, &[Vec2::new(-1.4, -2.5)]);
        for step in 0..80 {
            let (sin, cos) = (step as f32 * 0.03).sin_cos();
            for plant in [&mut wheels, &mut other] {
                plant.drive(0, Vec2::new(cos, sin) * 0.6);
                plant.advance();
            }
            let state = wheels.states()[0];
            let ahead = Vec2::new(state.heading.cos(), state.heading.sin());
            let off = (state.motion.position + ahead * 0.1 - other.states()[0].motion.position).norm();
            // The solver adds up the positions of a curve in four substeps.
            assert!(off < 0.03, "step {step}: {off} m");
            let sideways = ahead.x * state.motion.velocity.y - ahead.y * state.motion.velocity.x;
            assert!(sideways.abs() < 1e-3, "step {step}: it slides at {sideways} m/s");
        }
        wheels.place(0, Vec2::zeros(), 1.0);
        assert_eq!((wheels.states()[0].heading, wheels.states()[0].yaw_rate), (1.0, 0.0));
    }

    #[test]
    fn a_head_on_crash_is_flagged_does_not_overlap_and_keeps_momentum() {
        for speed in [0.3, 1.0, 1.5, 2.5] {
            let mut plant = plant(&prompt(), &[Vec2::new(-1.0, -1.5), Vec2::new(1.0, -1.5)]);
            let commands = [Vec2::new(speed, 0.0), Vec2::new(-speed, 0.0)];
            let (mut least, mut flagged) = (f32::INFINITY, false);
            drive_all(&mut *plant, &commands, 200, |states| {
                let apart = (states[0].motion.position - states[1].motion.position).norm();
                least = least.min(apart);
                flagged |= states[0].contacts.robot;
                assert_eq!(states[0].contacts.robot, apart <= 2.0 * HULL_M);
                assert_eq!(states[0].contacts, states[1].contacts);
                let momentum = states[0].motion.velocity + states[1].motion.velocity;
                assert!(momentum.norm() < 1e-3, "equal and opposite: {momentum:?}");
            });
            assert!(flagged && least < 0.32, "the contact is flagged: {least}");
            assert!(least > 0.30, "{speed} m/s: {least} m apart");
        }
    }

    #[test]
    fn walls_and_rails_stop_robots_that_push_against_them() {
        let arena = arena();
        for (start, command) in [
            (Vec2::new(1.0, -1.0), Vec2::new(0.0, 2.5)),
            (Vec2::new(0.3, -1.0), Vec2::new(0.3, 2.5)),
            (Vec2::new(1.5, -2.0), Vec2::new(2.0, -2.0)),
            (Vec2::new(1.9, -0.4), Vec2::new(1.5, 2.0)),
        ] {
            // A second robot pushes from behind.
            let mut plant = plant(&prompt(), &[start, start - command.normalize() * 0.4]);
            let mut least = f32::INFINITY;
            drive_all(&mut *plant, &[command, command], 100, |states| {
                for state in states {
                    let at = state.motion.position;
                    least = least.min(arena.clearance(at));
                    assert_eq!(state.contacts.wall, arena.clearance(at) <= HULL_M);
                    let outside = (at.abs() - arena.half_extent).max();
                    assert!(outside <= 0.0, "{outside} m off the ground");
                }
            });
            assert!(least > HULL_M - 0.01, "{start:?}: {least} m from a wall");
        }
    }

    #[test]
    fn robots_driven_into_a_corner_never_overlap_deeply() {
        let starts: Vec<Vec2> =
            (0..12).map(|k| Vec2::new((k % 4) as f32 * 0.5 - 1.0, (k / 4) as f32 * 0.5 - 2.5)).collect();
        let physics = Physics { acceleration_m_s2: f32::INFINITY, ..Physics::robomaster(&arena()) };
        for seed in 0..8 {
            let mut plant = build(&arena(), &physics, &starts, Seed::of_run(seed));
            let mut least = f32::INFINITY;
            drive_all(&mut *plant, &[Vec2::new(1.5, -1.5); 12], 200, |states| {
                for (index, state) in states.iter().enumerate() {
                    for other in &states[..index] {
                        least = least.min((state.motion.position - other.motion.position).norm());
                    }
                }
            });
            assert!(least > 0.30, "seed {seed}: {least} m");
        }
    }

    #[test]
    fn a_placed_robot_is_at_rest_and_can_be_driven_again() {
        let mut plant = plant(&prompt(), &[Vec2::new(-1.0, -1.5), Vec2::new(-1.0, -1.0)]);
        drive_all(&mut *plant, &[Vec2::new(0.0, 1.0); 2], 30, |_| {});
        plant.place(0, Vec2::new(0.5, 2.0), 0.0);
        let state = plant.states()[0];
        assert_eq!((state.motion.position, state.motion.velocity), (Vec2::new(0.5, 2.0), Vec2::zeros()));
        plant.advance();
        assert_eq!(plant.states()[0].motion.position, Vec2::new(0.5, 2.0), "its command is cleared, too");
        drive_all(&mut *plant, &[Vec2::new(0.0, 0.5); 2], 20, |_| {});
        assert!(plant.states()[0].motion.position.y > 2.3);
    }
}
