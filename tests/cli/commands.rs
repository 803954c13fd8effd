//! The commands of the whole program, and its error for those that it was built without.

use crate::program::{commands, refuses};
use murmurate_robot::features::WHOLE;

/// Commands that a robot's program has, too.
const OF_ROBOT: [&str; 8] = ["policy", "host", "doctor", "stop", "resume", "place", "key", "config"];

#[test]
fn a_program_has_the_commands_of_a_robot_and_those_that_a_robot_s_program_says_it_lacks() {
    let built = |name: &&&str| **name != "lab" || cfg!(feature = "lab");
    let mut wanted: Vec<&str> = OF_ROBOT.iter().chain(WHOLE.iter().filter(built)).copied().collect();
    wanted.sort_unstable();
    assert_eq!(commands(), wanted);
}

#[test]
fn a_command_of_a_missing_feature_says_which_one_the_program_needs() {
    if !cfg!(feature = "lab") {
        refuses(&["lab", "--help"], &["'lab'", "without the feature 'lab'", "cargo build", "--features lab"]);
        refuses(&["lab", "up", "lab.toml"], &["the feature 'lab'", "--features lab"]);
        refuses(&["launch", "team.toml", "--lab", "lab.toml"], &["'--lab'", "--features lab"]);
    }
    refuses(&["labs", "up"], &["labs"]);
}
