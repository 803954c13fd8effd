//! Event loop for a recorded run: runs actors through the turns of an earlier run in real time, with the time and the
//! inputs of each turn. It does the same as the event loop in `real`, but reads neither a real clock nor file
//! descriptors.

use super::clock::Clock;
use super::drive::Tasks;
use super::real::Readers;
use super::shell::in_system;
use crate::time::Time;

/// Runs actors on the calling thread through the recorded turns of an event loop. `build` starts the actors at the time
/// `begun` and returns their owner, which is returned at the end; file descriptors that it registers are never read. A
/// turn is a time and the inputs at that time. In each turn, due events are executed, `arrive` passes the inputs on to
/// the actors, and after the actors have run, `end` is called.
pub fn run_replayed<W, T>(
    begun: Time,
    build: impl FnOnce(&Clock, &mut Readers) -> W,
    turns: impl Iterator<Item = (Time, T)>,
    mut arrive: impl FnMut(&W, &mut T),
    mut end: impl FnMut(&W, Time, T),
) -> W {
    in_system(|| {
        let (clock, mut readers, mut actors) = (Clock::default(), Readers::new(), Tasks::new());
        clock.set(begun);
        let world = {
            let _inside = actors.enter();
            build(&clock, &mut readers)
        };
        for (now, mut turn) in turns {
            clock.set(now);
            while clock.catch_up() {}
            actors.drain(&clock);
            arrive(&world, &mut turn);
            actors.drain(&clock);
            end(&world, now, turn);
        }
        clock.clear();
        world
    })
}
