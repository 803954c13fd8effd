//! Commands and flags that this program may lack.

use murmurate_robot::features::Part;

/// Parts that features of the build add.
pub const PARTS: &[Part] = &[Part {
    words: &["lab", "--lab"],
    feature: "lab",
    build: "cargo build --release --features lab",
    there: cfg!(feature = "lab"),
}];
