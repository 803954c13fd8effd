//! The actor graph in one process under virtual time: whole trials and their guarantees.

mod common;
mod contracts;
mod determinism;
mod devices;
mod faults;
#[cfg(feature = "study")]
mod growth;
mod judged;
#[cfg(feature = "rigid")]
mod physics;
mod radio;
mod reference;
mod safety;
mod shell;
mod transports;
