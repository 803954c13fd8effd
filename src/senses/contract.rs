//! Contract of kinds of senses, which every entry of a registry keeps. Tests of this crate and of others check it.

use std::sync::Arc;

use super::{Entry, In, Layout, Out, Sense, Site};
use crate::edge::Settings;
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::{Scene, Standing};
use crate::random::{RngExt, Seed};
use crate::scenario::Arena;
use crate::time::{Span, Time};

/// Number of scenes, and of packets of random bytes, that a sense gets.
const INPUTS: u64 = 200;
/// Number of values of the sense `task` of each robot: that of its example.
const OBSERVED: usize = 2;

/// Checks that a kind of sense keeps its contract, with the settings of its example: it refuses a setting that it does
/// not know; its values are as many as its layout says, and each is a number or no echo; equal inputs and streams give
/// equal values; no packet makes it panic; and what is due is done when it is woken. An error says what it does not
/// keep.
pub fn check(entry: &Entry) -> Result<(), String> {
    let table: toml::Table = entry.example.parse().map_err(|error| format!("its example is no TOML: {error}"))?;
    let settings = Settings { name: "example".to_owned(), table };
    let mut unknown = settings.clone();
    unknown.table.insert("no-such-setting".to_owned(), toml::Value::Boolean(true));
    if (entry.make)(&unknown, RobotId(0)).is_ok() {
        return Err("it takes a setting that it does not know".to_owned());
    }
    let run = || -> Result<Vec<Out>, String> {
        let parts = (entry.make)(&settings, RobotId(1)).map_err(|error| format!("its example is refused: {error}"))?;
        if let Some(why) = parts.layout.unfit() {
            return Err(why);
        }
        let arena = Arena::new(Vec2::new(3.0, 3.0), Vec::new(), 0.25);
        let stream = Seed::of_run(1).stream("sense");
        let mut sense = (parts.sense)(Site { robot: RobotId(1), arena: &arena, stream });
        let out = fed(&mut *sense)?;
        valid(&out, &parts.layout)?;
        let seen = out.iter().any(|out| matches!(out, Out::Values { .. }));
        if parts.worker.is_none() && !seen {
            return Err("it is simulated, and perceives nothing in a scene".to_owned());
        }
        Ok(out)
    };
    if run()? != run()? {
        return Err("equal inputs and streams give other values".to_owned());
    }
    Ok(())
}

/// Gives a sense scenes and packets of random bytes, wakes it when it asks for it, and returns what it puts out.
fn fed(sense: &mut dyn Sense) -> Result<Vec<Out>, String> {
    let (mut stream, mut out) = (Seed::of_run(2).stream("inputs"), Vec::new());
    for step in 0..INPUTS {
        let now = Time::ZERO + Span::from_millis(50 * step);
        let mut waking = 0;
        while let Some(due) = sense.wake_at().filter(|due| *due <= now) {
            sense.wake(due, &mut out);
            waking += 1;
            if waking > INPUTS {
                return Err("when it is woken it asks to be woken at once, for ever".to_owned());
            }
        }
        let robots: Arc<[Standing]> = (0..4u16)
            .map(|robot| {
                let mut number = || stream.random_range(-3.0..3.0);
                Standing { robot: RobotId(robot), centre: Vec2::new(number(), number()), heading: number() }
            })
            .collect();
        let observed = (0..robots.len() * OBSERVED).map(|_| stream.random_range(-3.0..3.0)).collect();
        let scene = Scene { time: now, placed: step % 20 == 0, episode: 0, elapsed: None, robots, observed };
        sense.take(now, In::Scene(&scene), &mut out);
        let length = stream.random_range(0..100);
        let packet: Vec<u8> = (0..length).map(|_| stream.random()).collect();
        sense.take(now, In::Packet(&packet), &mut out);
    }
    Ok(out)
}

/// Checks that all values are as many as the layout says, and numbers or no echoes.
fn valid(out: &[Out], layout: &Layout) -> Result<(), String> {
    for out in out {
        let Out::Values { values, .. } = out else { continue };
        if values.len() != layout.floats() {
            return Err(format!("it puts out {} values; its layout has {}", values.len(), layout.floats()));
        }
        if let Some(value) = values.iter().find(|value| !(value.abs() <= 1e6 || **value == f32::INFINITY)) {
            return Err(format!("it puts out {value}"));
        }
    }
    Ok(())
}
