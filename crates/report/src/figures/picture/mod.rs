//! Pictures of one episode: two animations and a still picture, each a self-contained file.

mod film;
mod movers;
mod moving;
mod scene;
mod sheet;
mod space;
mod still;

pub use film::film;
pub use moving::moving;
pub use scene::{Backdrop, Ending, Link, Ring, Scan, Scene, SceneFrame};
pub use still::still;
