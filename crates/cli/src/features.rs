//! Commands and flags that this program may lack.

use murmurate_robot::features::Part;

/// Parts that features of the build add.
pub const PARTS: &[Part] = &[Part { words: &["lab", "--lab"], feature: Some("lab"), there: cfg!(feature = "lab") }];
