//! The twin of a recorded run: a model that is fitted to the first half of its episodes and predicts the second half.
//!
//! Pure but for [`observed`], which reads records. The program runs the repeats of the prediction on threads and writes
//! the files. `docs/twin.md` is a guide.

pub mod ages;
pub mod comparison;
pub mod estimate;
pub mod lag;
pub mod links;
pub mod missing;
pub mod model;
pub mod observed;
pub mod offsets;
pub mod pages;
pub mod path;
pub mod predict;
