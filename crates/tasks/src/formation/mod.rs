//! Formation: a team takes a wedge behind its leader and keeps it on the way past waypoints. If the leader is lost, the
//! robot with the next number leads.
//!
//! The wedge does not turn. It is described by the place of each robot relative to the place of robot 0, the point of
//! the wedge, so that the team has one reference, the leader's position minus its place, whichever robot leads.

pub mod policy;
pub mod scenario;
pub mod size;
