//! Model of a robot's drivetrain, from commanded to true velocity: a first-order lag, limits of speed,
//! acceleration and traction, and wheel slip.

use super::Physics;
use super::sensor::standard_normals;
use crate::messages::geometry::Vec2;
use crate::random::Stream;
use crate::time::Span;

/// State of the simulated drivetrain of one robot: its commanded velocity, and its wheel slip.
#[derive(Debug)]
pub(super) struct Drivetrain {
    /// Commanded velocity of the robot's commanded point \[m/s\], world frame.
    pub(super) command: Vec2,
    /// Slip velocity as a fraction of the commanded speed.
    slip: Vec2,
    stream: Stream,
}

/// Parameters of one step of the drivetrain model, shared by all drivetrains of a world.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepParameters {
    top_speed_m_s: f32,
    /// Fraction of the difference to the wanted velocity that one step makes up.
    gain: f32,
    /// Largest change of velocity in a step along each axis \[m/s\].
    axis_change_m_s: f32,
    /// Largest change of velocity in a step in any direction \[m/s\].
    pub(super) total_change_m_s: f32,
    /// Factor by which slip decays in a step.
    slip_decay: f32,
    /// Standard deviation of the noise added to slip in a step.
    slip_noise: f32,
}

impl StepParameters {
    /// Computes the parameters for steps of duration `step`, from the physical parameters of the world's robots.
    pub(super) fn new(physics: &Physics, step: Span) -> StepParameters {
        let step_s = step.as_secs() as f32;
        let slip_decay =
            if physics.slip_s > 0.0 { libm::exp(-step.as_secs() / f64::from(physics.slip_s)) as f32 } else { 0.0 };
        StepParameters {
            top_speed_m_s: physics.top_speed_m_s,
            gain: physics.gain(step),
            axis_change_m_s: physics.acceleration_m_s2 * step_s,
            total_change_m_s: physics.traction_m_s2 * step_s,
            slip_decay,
            // Slip is an Ornstein-Uhlenbeck process: its standard deviation must not depend on the step.
            slip_noise: physics.slip * (1.0 - slip_decay * slip_decay).sqrt(),
        }
    }
}

impl Drivetrain {
    /// Makes a drivetrain that is commanded to stand and does not slip. Its slip is drawn from `stream`.
    pub(super) fn new(stream: Stream) -> Drivetrain {
        Drivetrain { command: Vec2::zeros(), slip: Vec2::zeros(), stream }
    }

    /// Draws the slip of one step and returns the change of velocity \[m/s\] in the step of a commanded point that
    /// moves at `velocity` \[m/s\], world frame.
    pub(super) fn velocity_change(&mut self, parameters: &StepParameters, velocity: Vec2) -> Vec2 {
        if parameters.slip_noise > 0.0 {
            let noise = standard_normals(&mut self.stream) * parameters.slip_noise;
            self.slip = self.slip * parameters.slip_decay + noise;
        }
        let command = limit_norm(self.command, parameters.top_speed_m_s);
        let wanted = command + self.slip * command.norm();
        let max = parameters.axis_change_m_s;
        let change = ((wanted - velocity) * parameters.gain).map(|axis| axis.clamp(-max, max));
        limit_norm(change, parameters.total_change_m_s)
    }
}

/// Returns the vector, scaled down to the length `length` if it is longer.
pub(super) fn limit_norm(vector: Vec2, length: f32) -> Vec2 {
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
    fn velocity_follows_a_step_of_the_command_with_a_first_order_lag() {
        let physics = Physics { slip: 0.0, ..physics() };
        let parameters = StepParameters::new(&physics, STEP);
        let (mut wheels, mut velocity) = (drivetrain(Vec2::new(0.8, -0.4)), Vec2::zeros());
        for step in 1..=60 {
            velocity += wheels.velocity_change(&parameters, velocity);
            let share = 1.0 - (-(step as f32) * 0.05 / physics.lag_s).exp();
            assert!((velocity - wheels.command * share).norm() < 1e-5, "after {step} steps: {velocity:?}");
        }
    }

    #[test]
    fn speed_and_acceleration_are_limited() {
        let prompt = Physics { slip: 0.0, lag_s: 0.0, ..physics() };
        let first = |physics: &Physics| {
            let parameters = StepParameters::new(physics, STEP);
            drivetrain(Vec2::new(-30.0, 40.0)).velocity_change(&parameters, Vec2::zeros())
        };
        let change = first(&prompt);
        assert!((change.norm() - prompt.traction_m_s2 * 0.05).abs() < 1e-6 && change.x < 0.0);
        let strong = Physics { traction_m_s2: f32::INFINITY, ..prompt };
        assert!((first(&strong).norm() - strong.top_speed_m_s).abs() < 1e-5);
        let gentle = Physics { acceleration_m_s2: 1.0, ..prompt };
        assert_eq!(first(&gentle), Vec2::new(-0.05, 0.05), "axis by axis");
    }

    #[test]
    fn slip_has_its_standard_deviation_and_correlation_time_and_is_zero_at_rest() {
        let physics = Physics { lag_s: 0.0, traction_m_s2: f32::INFINITY, ..physics() };
        let parameters = StepParameters::new(&physics, STEP);
        let mut wheels = drivetrain(Vec2::new(2.0, 0.0));
        let slips: Vec<Vec2> =
            (0..20_000).map(|_| (wheels.velocity_change(&parameters, Vec2::zeros()) - wheels.command) / 2.0).collect();
        let squares = slips.iter().fold(Vec2::zeros(), |sum, slip| sum + slip.component_mul(slip)) / 20_000.0;
        let together: f32 = slips.windows(2).map(|pair| pair[0].x * pair[1].x).sum::<f32>() / 20_000.0;
        assert!((squares.map(f32::sqrt) / physics.slip).add_scalar(-1.0).abs().max() < 0.15, "{squares:?}");
        assert!((together / squares.x - (-0.05f32 / physics.slip_s).exp()).abs() < 0.03, "{together}");
        wheels.command = Vec2::zeros();
        assert_eq!(wheels.velocity_change(&parameters, Vec2::zeros()), Vec2::zeros());
    }
}
