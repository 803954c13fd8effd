//! Driver of recorded time: runs actors through the turns of an earlier real-time run, with the times and the inputs of
//! each. It follows `real`, line by line, without a clock and without descriptors.

use super::clock::Clock;
use super::drive::Tasks;
use super::real::Readers;
use super::shell::in_system;
use crate::time::Time;

/// Runs actors on the calling thread through recorded turns. `build` starts the actors at the time `begun`; what it
/// watches is never read. Each turn is a time and its inputs: after the due events, `arrive` passes the inputs on to
/// the actors, and `end` is called at the end of the turn.
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
