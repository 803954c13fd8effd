//! Error of the estimators at the ticks of an agent, for robots that move like those of a team.

use murmurate::estimation::{self, Settings};
use murmurate::localization::simulated::Simulated;
use murmurate::localization::{In, Out, Source};
use murmurate::messages::geometry::{Motion, Planar, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{Contacts, Sample};
use murmurate::random::{RngExt, Seed};
use murmurate::registry::Registry;
use murmurate::time::{Span, Time};
use murmurate::world::Sensor;

/// Period of a World's steps, and of an agent's ticks, which are halfway between two steps.
const STEP: Span = Span::from_millis(10);
const TICK: u64 = 5;

/// Returns the root mean square of the position's error at the ticks \[m\], over ten minutes. The robot changes its
/// wanted velocity every two seconds and accelerates at 1 m/s².
fn error_m(estimator: &str, sensor: Sensor) -> f64 {
    let seed = Seed::of_run(5);
    let mut source = Simulated::new(sensor, seed.stream("sensor"));
    let entry = *Registry::builtin().estimator(estimator).expect("it is there");
    let mut estimator = (entry.make)(&Settings { delay: sensor.latency });
    let (mut wishes, mut wish) = (seed.stream("wishes"), Vec2::zeros());
    let (mut motion, mut now) = (Motion::at_rest(Vec2::zeros()), Time::ZERO);
    let (mut squares, mut ticks) = (0.0, 0);
    let dt = STEP.as_secs() as f32;
    for step in 0..60_000_u64 {
        if step % 200 == 0 {
            wish = Vec2::new(wishes.random_range(-0.9..0.9), wishes.random_range(-0.9..0.9));
        }
        motion.velocity += (wish - motion.velocity).capped(dt);
        motion.position += motion.velocity * dt;
        now += STEP;
        let sample = Sample {
            robot: RobotId(0),
            time: now,
            motion,
            heading: 0.0,
            yaw_rate: 0.0,
            command: wish,
            contacts: Contacts::default(),
        };
        let mut out = Vec::new();
        source.wake(now, &mut out);
        source.take(now, In::Sample(&sample), &mut out);
        for said in out {
            let Out::Reading(reading) = said else { panic!("a simulated sensor measures") };
            estimator.take(now, &reading);
        }
        if step % TICK == 0 && step > 500 {
            let estimate = estimator.at(now).expect("it was measured");
            squares += f64::from((estimate.position - motion.position).norm_squared());
            ticks += 1;
        }
    }
    (squares / f64::from(ticks)).sqrt()
}

/// Share of age in the error of a source \[m\]: without the error of the same source that is prompt and read at every
/// step.
fn due_to_age(estimator: &str, sensor: Sensor) -> f64 {
    let prompt = Sensor { latency: Span::ZERO, period: STEP, ..sensor };
    (error_m(estimator, sensor).powi(2) - error_m("none", prompt).powi(2)).max(0.0).sqrt()
}

#[test]
fn the_filter_at_least_halves_the_error_that_is_due_to_age() {
    for (name, sensor) in [("motion capture", Sensor::MOTION_CAPTURE), ("RTK", Sensor::RTK)] {
        let [none, kalman] = ["none", "kalman"].map(|estimator| due_to_age(estimator, sensor));
        println!("{name}: {:.2} mm as it is, {:.2} mm filtered", 1e3 * none, 1e3 * kalman);
        assert!(kalman <= 0.5 * none, "{name}: {kalman} of {none}");
    }
}

#[test]
fn no_estimator_adds_to_the_error_of_an_exact_source() {
    for entry in Registry::builtin().estimators() {
        let error = error_m(entry.name, Sensor::EXACT);
        assert!(error < 1e-3, "{}: {error}", entry.name);
    }
    assert_eq!(estimation::REGISTRY[0].name, "none", "the default");
}
