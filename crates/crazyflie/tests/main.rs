//! The driver `crazyflie` against the fake Crazyflie, in simulated time: each run is the same every time. The worker is
//! tested over a socket, where it is built in.

mod bench;
#[allow(dead_code)] // Each program of tests uses its part.
mod firmware;
mod flights;
mod lossy;
#[cfg(feature = "link")]
mod sockets;
