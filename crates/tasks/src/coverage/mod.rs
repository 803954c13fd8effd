//! Cooperative coverage: a team of robots spreads over a ground so that what is important is near a robot.
//!
//! The importance of places is a density on a square grid ([`field`]). The [`cost`] of a team is the sum over the cells
//! of density times squared distance to the nearest robot. Robots do not know the density: each senses the cells
//! around it ([`seen`]). Scripted controllers drive each robot to the centroid of its Voronoi cell ([`voronoi`],
//! [`baselines`]), after Cortes, Martinez, Karatas and Bullo, "Coverage control for mobile sensing networks", IEEE
//! Transactions on Robotics and Automation 20 (2), 2004. The task is that of Agarwal, Muthukrishnan, Gosrich, Kumar and
//! Ribeiro, "LPAC: Learnable Perception-Action-Communication Loops", arXiv 2401.04855. docs/coverage.md says how the
//! results agree with those of its authors' library, CoverageControl.
//!
//! All places are \[m\], in the frame of the ground, whose lower corner is the origin.

pub mod baselines;
pub mod channels;
pub mod cost;
pub mod field;
pub mod grid;
pub mod policy;
pub mod privileged;
pub mod rest;
pub mod run;
pub mod scenario;
pub mod seen;
pub mod size;
pub mod voronoi;

/// Place on the ground \[m\], in the frame of the ground.
pub type Point = [f64; 2];
