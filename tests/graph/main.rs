//! The actor graph in one process under virtual time: whole trials and their guarantees.

mod bad_entries;
mod behaviours;
mod built_in;
mod common;
mod contracts;
mod determinism;
mod devices;
mod drawn;
mod drives;
mod estimators;
mod faults;
mod filter;
mod flight;
mod gpsd;
mod judged;
mod liars;
mod mesh;
mod movers;
mod natnet;
#[cfg(feature = "rigid")]
mod physics;
mod poses;
mod radio;
mod reference;
mod robomaster;
mod roles;
mod safety;
mod senses;
mod shell;
#[path = "../skip/mod.rs"]
mod skip;
mod space;
mod steps;
mod task_files;
mod trained_tasks;
mod transports;
mod unlabelled;
mod users;
mod waypoints;
