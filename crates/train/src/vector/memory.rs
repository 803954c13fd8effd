//! Memory that vectorised environments take, reckoned before any of it is allocated.

use std::mem::size_of;

use super::{Content, Options};
use crate::environments::TrainingTeam;
use crate::message_buffer::HISTORY_STEPS;
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::random::Stream;
use murmurate::safety::filter::Filter;
use murmurate::scenario::{Arena, KeepOut};
use murmurate::world::{Physics, Wheels};

/// What an allocation costs beside its content \[bytes\].
const ALLOCATION: usize = 32;
/// Factor for vectors that grow, and for what is made before what it replaces is dropped.
const MARGIN: f64 = 1.2;

impl Options {
    /// Returns an upper bound of the memory that the environments take together with their buffers \[bytes\].
    pub fn memory_bytes(&self) -> u64 {
        let lengths = self.lengths();
        let (r, f, m) = (lengths.robots as f64, lengths.observation as f64, lengths.message as f64);
        let size = |bytes: usize| bytes as f64;
        let (float, edges) = (size(size_of::<f32>()), r * r);
        // The message buffer with its estimates, held and undrawn messages; an episode with its phases and edges.
        let messages =
            r * size(HISTORY_STEPS) * 4.0 * float + edges * size(size_of::<Option<u32>>() + size_of::<u32>());
        let episode = r * float + edges * 2.0 * float;
        let blocks = |arena: &Arena| arena.keep_outs.len() + 2 * arena.portals.len();
        let drawn = self.scenario.drawn_arena(0, 0).map_or(0, |arena| blocks(&arena));
        let walls = size((self.scenario.arena().keep_outs.len() + drawn) * size_of::<KeepOut>());
        let team = size(2 * size_of::<TrainingTeam>() + size_of::<Physics>() + size_of::<Stream>() + 8 * ALLOCATION)
            + messages
            + 2.0 * episode
            + walls;
        let robot = size(size_of::<Option<Filter>>() + size_of::<Wheels>() + size_of::<Contacts>())
            + size(2 * size_of::<Task>() + 8 * size_of::<Vec2>() + size_of::<(Contacts, f32)>())
            + 4.0 * float;
        let outputs =
            if matches!(self.content, Content::Actions(_)) { r * m * size(HISTORY_STEPS) * float } else { 0.0 };
        let heard = if m > 0.0 { edges * (1.0 + float + m * float) } else { 0.0 };
        let buffers = r * (2.0 * (f + lengths.rays as f64) * float + float + 1.0) + 2.0 + heard;
        let all = size(self.environments) * MARGIN * (team + r * robot + outputs + buffers);
        all as u64 + (1 << 20)
    }
}
