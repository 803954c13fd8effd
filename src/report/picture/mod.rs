//! One episode to look at: as an animation and as a still. Data in, text out; nothing is loaded when it is shown.

mod film;
mod moving;
mod scene;
mod sheet;
mod still;

pub use film::film;
pub use moving::moving;
pub use scene::{Ending, Frame, Link, Ring, Scene, Stage};
pub use still::still;
