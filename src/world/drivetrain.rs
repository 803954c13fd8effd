//! The drivetrain of a holonomic robot: how its velocity follows what is commanded. A first-order lag, limits of
//! speed, acceleration and traction, and wheels that slip.

use super::Physics;
use super::sensor::drawn;
use crate::messages::geometry::Vec2;
use crate::random::Stream;
use crate::time::Span;

/// The wheels of one robot.
#[derive(Debug)]
pub(super) struct Drivetrain {
    /// What is commanded \[m/s\].
    pub(super) command: Vec2,
    /// What slips, as a share of the commanded speed.
    slip: Vec2,
    stream: Stream,
}

/// What the drivetrains of a world have in common: their physics over one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gears {
    top_speed_m_s: f32,
    /// Share of a change of velocity that is made in a step.
    gain: f32,
    /// Largest changes of velocity in a step: along each axis, and in any direction \[m/s\].
    along_axis_m_s: f32,
    in_all_m_s: f32,
    /// What is left of a slip after a step, and the deviation of what comes to it.
    kept: f32,
    fresh: f32,
}

impl Gears {
    pub(super) fn new(physics: &Physics, step: Span) -> Gears {
        let step_s = step.as_secs() as f32;
        let kept =
            if physics.slip_s > 0.0 { libm::exp(-step.as_secs() / f64::from(physics.slip_s)) as f32 } else { 0.0 };
        Gears {
            top_speed_m_s: physics.top_speed_m_s,
            gain: physics.gain(step),
            along_axis_m_s: physics.acceleration_m_s2 * step_s,
            in_all_m_s: physics.traction_m_s2 * step_s,
            kept,
            // So that an Ornstein-Uhlenbeck process keeps its deviation, whatever the step.
            fresh: physics.slip * (1.0 - kept * kept).sqrt(),
        }
    }
}

impl Drivetrain {
    pub(super) fn new(stream: Stream) -> Drivetrain {
        Drivetrain { command: Vec2::zeros(), slip: Vec2::zeros(), stream }
    }

    /// The change of velocity \[m/s\] that the wheels make of a robot that moves at `velocity` in one step.
    pub(super) fn pull(&mut self, gears: &Gears, velocity: Vec2) -> Vec2 {
        if gears.fresh > 0.0 {
            self.slip = self.slip * gears.kept + drawn(&mut self.stream) * gears.fresh;
        }
        let command = at_most(self.command, gears.top_speed_m_s);
        let wanted = command + self.slip * command.norm();
        let most = gears.along_axis_m_s;
        let change = ((wanted - velocity) * gears.gain).map(|axis| axis.clamp(-most, most));
        at_most(change, gears.in_all_m_s)
    }
}

/// The vector, shortened to this length if it is longer.
fn at_most(vector: Vec2, length: f32) -> Vec2 {
    let norm = vector.norm();
    if norm > length { vector * (length / norm) } else { vector }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;
    use crate::scenario::{Settings, build};

    const STEP: Span = Span::from_millis(50);

    fn physics() -> Physics {
        let passage = build("passage", &Settings::default()).unwrap();
        Physics { acceleration_m_s2: f32::INFINITY, ..Physics::robomaster(passage.arena()) }
    }

    fn drivetrain(command: Vec2) -> Drivetrain {
        Drivetrain { command, ..Drivetrain::new(Seed::of_run(3).stream("slip")) }
    }

    #[test]
    fn velocity_follows_a_step_as_a_first_order_lag_does() {
        let physics = Physics { slip: 0.0, ..physics() };
        let gears = Gears::new(&physics, STEP);
        let (mut wheels, mut velocity) = (drivetrain(Vec2::new(0.8, -0.4)), Vec2::zeros());
        for step in 1..=60 {
            velocity += wheels.pull(&gears, velocity);
            let share = 1.0 - (-(step as f32) * 0.05 / physics.lag_s).exp();
            assert!((velocity - wheels.command * share).norm() < 1e-5, "after {step} steps: {velocity}");
        }
    }

    #[test]
    fn speed_and_acceleration_are_limited() {
        let prompt = Physics { slip: 0.0, lag_s: 0.0, ..physics() };
        let first =
            |physics: &Physics| drivetrain(Vec2::new(-30.0, 40.0)).pull(&Gears::new(physics, STEP), Vec2::zeros());
        let pulled = first(&prompt);
        assert!((pulled.norm() - prompt.traction_m_s2 * 0.05).abs() < 1e-6 && pulled.x < 0.0);
        let strong = Physics { traction_m_s2: f32::INFINITY, ..prompt };
        assert!((first(&strong).norm() - strong.top_speed_m_s).abs() < 1e-5);
        let gentle = Physics { acceleration_m_s2: 1.0, ..prompt };
        assert_eq!(first(&gentle), Vec2::new(-0.05, 0.05), "axis by axis");
    }

    #[test]
    fn wheels_slip_as_much_as_they_are_said_to_and_not_at_rest() {
        let physics = Physics { lag_s: 0.0, traction_m_s2: f32::INFINITY, ..physics() };
        let gears = Gears::new(&physics, STEP);
        let mut wheels = drivetrain(Vec2::new(2.0, 0.0));
        let slips: Vec<Vec2> =
            (0..20_000).map(|_| (wheels.pull(&gears, Vec2::zeros()) - wheels.command) / 2.0).collect();
        let squares = slips.iter().fold(Vec2::zeros(), |sum, slip| sum + slip.component_mul(slip)) / 20_000.0;
        let together: f32 = slips.windows(2).map(|pair| pair[0].x * pair[1].x).sum::<f32>() / 20_000.0;
        assert!((squares.map(f32::sqrt) / physics.slip).add_scalar(-1.0).abs().max() < 0.15, "{squares}");
        assert!((together / squares.x - (-0.05f32 / physics.slip_s).exp()).abs() < 0.03, "{together}");
        wheels.command = Vec2::zeros();
        assert_eq!(wheels.pull(&gears, Vec2::zeros()), Vec2::zeros());
    }
}
