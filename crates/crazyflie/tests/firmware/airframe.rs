//! Airframe of the fake Crazyflie: commanders with their priorities and time-outs, a coarse model of flight, estimator.

/// Ages of the newest low-level setpoint at which the firmware levels the robot, and switches its motors off \[s\].
pub const LEVELS_S: f64 = 0.5;
pub const SHUTS_DOWN_S: f64 = 2.0;
/// Time in which the robot takes on a velocity \[s\].
const LAG_S: f64 = 0.15;

/// Low-level setpoint: velocity in the world or along the robot's axes \[m/s\], yaw rate
/// \[degrees/s\], counter-clockwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setpoint {
    Hover { velocity: [f64; 2], yaw_rate: f64, height: f64 },
    World { velocity: [f64; 3], yaw_rate: f64 },
}

/// Course that the high-level commander flies: from a height to another one, since a time, for a time \[s\].
#[derive(Clone, Copy, Debug)]
pub struct Course {
    from: f64,
    to: f64,
    since: f64,
    lasts: f64,
}

/// Quadrotor and the part of the firmware that flies it.
#[derive(Clone, Debug)]
pub struct Airframe {
    pub now: f64,
    /// True position \[m\] and velocity \[m/s\], heading \[rad\].
    pub at: [f64; 3],
    pub velocity: [f64; 3],
    pub yaw: f64,
    /// Position and heading by the estimator.
    pub estimate: [f64; 3],
    pub estimated_yaw: f64,
    pub motors: bool,
    /// Newest low-level setpoint with its time, while it has priority.
    pub low: Option<(f64, Setpoint)>,
    pub course: Option<Course>,
    pub crashed: bool,
    pub locked: bool,
    pub tumbled: bool,
    /// Fastest fall that hit the ground \[m/s\].
    pub hardest: f64,
}

impl Airframe {
    pub fn new(x: f64, y: f64, yaw: f64) -> Airframe {
        Airframe {
            now: 0.0,
            at: [x, y, 0.0],
            velocity: [0.0; 3],
            yaw,
            // It was switched on: it believes to be at the origin.
            estimate: [0.0; 3],
            estimated_yaw: 0.0,
            motors: false,
            low: None,
            course: None,
            crashed: false,
            locked: false,
            tumbled: false,
            hardest: 0.0,
        }
    }

    pub fn may_fly(&self) -> bool {
        !(self.crashed || self.locked || self.tumbled)
    }

    pub fn flies(&self) -> bool {
        self.motors && self.at[2] > 0.02
    }

    /// Whether the high-level commander flies the robot.
    pub fn is_led(&self) -> bool {
        self.motors && self.low.is_none() && self.course.is_some()
    }

    pub fn takes(&mut self, setpoint: Setpoint) {
        if self.may_fly() {
            self.low = Some((self.now, setpoint));
            self.motors = true;
        }
    }

    pub fn goes(&mut self, to: f64, lasts: f64) {
        if self.may_fly() && (to > 0.0 || self.motors) {
            self.course = Some(Course { from: self.at[2], to, since: self.now, lasts: lasts.max(0.1) });
            self.motors = true;
        }
    }

    pub fn off(&mut self) {
        (self.motors, self.low, self.course) = (false, None, None);
    }

    /// Takes a position from outside.
    pub fn told(&mut self, position: [f64; 3], yaw: Option<f64>) {
        for (estimate, told) in self.estimate.iter_mut().zip(position) {
            *estimate += 0.3 * (told - *estimate);
        }
        if let Some(yaw) = yaw {
            let turn = (yaw - self.estimated_yaw + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
            self.estimated_yaw += 0.3 * (turn - std::f64::consts::PI);
        }
    }

    /// Begins the estimator anew.
    pub fn begin(&mut self, position: [f64; 3], yaw: f64) {
        (self.estimate, self.estimated_yaw) = (position, yaw);
    }

    /// Moves on by a time \[s\].
    pub fn step(&mut self, dt: f64) {
        self.now += dt;
        if !self.may_fly() {
            self.off();
        }
        let age = self.low.map(|(since, _)| self.now - since);
        if age.is_some_and(|age| age >= SHUTS_DOWN_S) {
            self.off();
        }
        let (wanted, yaw_rate) = self.wanted(age);
        if self.motors {
            for (velocity, wanted) in self.velocity.iter_mut().zip(wanted) {
                *velocity += (wanted - *velocity) * (dt / LAG_S).min(1.0);
            }
        } else {
            self.velocity = [0.0, 0.0, if self.at[2] > 0.0 { self.velocity[2] - 9.81 * dt } else { 0.0 }];
        }
        self.yaw += yaw_rate.to_radians() * dt;
        self.estimated_yaw += yaw_rate.to_radians() * dt;
        for (k, velocity) in self.velocity.iter().enumerate() {
            self.at[k] += velocity * dt;
            self.estimate[k] += velocity * dt;
        }
        // Measurement of its deck.
        self.estimate[2] = self.at[2].max(0.0);
        self.land();
    }

    fn land(&mut self) {
        if self.at[2] <= 0.0 {
            self.hardest = self.hardest.max(-self.velocity[2]);
            self.crashed |= self.velocity[2] < -1.5;
            (self.at[2], self.velocity[2]) = (0.0, self.velocity[2].max(0.0));
        }
        let over = self.course.is_some_and(|course| course.to <= 0.0 && self.now - course.since >= course.lasts);
        if over && self.low.is_none() && self.at[2] < 0.03 {
            self.off();
        }
    }

    /// Returns the velocity that the commander in charge wants, and the yaw rate.
    fn wanted(&self, age: Option<f64>) -> ([f64; 3], f64) {
        match (self.low, age) {
            (Some(_), Some(age)) if age >= LEVELS_S => ([self.velocity[0], self.velocity[1], 0.0], 0.0),
            (Some((_, Setpoint::World { velocity, yaw_rate })), _) => (velocity, yaw_rate),
            (Some((_, Setpoint::Hover { velocity: [ahead, left], yaw_rate, height })), _) => {
                let (sin, cos) = self.estimated_yaw.sin_cos();
                let climb = (2.0 * (height - self.at[2])).clamp(-0.5, 0.5);
                ([cos * ahead - sin * left, sin * ahead + cos * left, climb], yaw_rate)
            }
            (None, _) => {
                let Some(course) = self.course else { return ([0.0; 3], 0.0) };
                let part = ((self.now - course.since) / course.lasts).clamp(0.0, 1.0);
                let height = course.from + part * (course.to - course.from);
                ([0.0, 0.0, (8.0 * (height - self.at[2])).clamp(-0.6, 0.6)], 0.0)
            }
        }
    }
}
