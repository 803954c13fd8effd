//! Stage of a record: hosts, ground and walls, which a picture needs in addition to the robots' states. It is the
//! metadata `murmurate.stage` of the record's file, so a record can be shown without the program and the files that
//! made it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use murmurate::deploy::{Deployment, Routes};
use murmurate::messages::geometry::Planar;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{Arena, DrawnMover, KeepOut, Scenario, Solid};
use murmurate::trial::Trial;

/// Name of the MCAP metadata of a record that contains the [`Stage`].
pub const METADATA: &str = "murmurate.stage";
/// Name of the only entry of the metadata; its value is the stage as JSON.
const ENTRY: &str = "stage";

/// Constant properties of a run that a picture of it needs, besides the robots' states: ground, walls, hosts and
/// robots.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the deployment's mode.
    pub mode: String,
    /// Names of the hosts, in the order of host ids.
    pub hosts: Vec<String>,
    /// Host that runs each robot's agent, in the order of robot ids.
    pub homes: Vec<HostId>,
    /// Number of robots.
    pub robots: usize,
    /// Half the size of the ground along x and y \[m\]; its middle is the origin.
    pub half_extent: [f32; 2],
    /// Walls and other solid blocks \[m\], world frame.
    pub walls: Vec<Solid>,
    /// Walls and obstacles of each episode, where obstacles are drawn for each; empty where all episodes have `walls`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub drawn: Vec<Vec<Solid>>,
    /// Obstacles that move while an episode runs; empty if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub movers: Vec<DrawnMover>,
    /// Waypoints of each robot in each episode \[m\], world frame; empty if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub waypoints: Vec<Vec<Vec<[f32; 2]>>>,
    /// Whether goals belong to no robot.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unlabelled: bool,
    /// Radius of a robot's hull \[m\].
    pub hull_m: f32,
    /// Range within which robots use each other's messages \[m\]; `None` if it is unlimited.
    pub range_m: Option<f32>,
    /// Senses of each robot, in the order of their indices.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub senses: Vec<StageSense>,
}

/// Sense of each robot of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageSense {
    /// Name of the sense.
    pub name: String,
    /// Angles of its first and last ray \[rad\], counter-clockwise from the direction ahead; `None` if its values are
    /// no distances along rays.
    pub rays_rad: Option<[f64; 2]>,
    /// Place from which the rays go \[m\]: ahead of the robot's centre and to the left.
    pub mount_m: [f32; 2],
}

impl Stage {
    /// Returns the stage of a trial.
    pub fn of(trial: &Trial) -> Stage {
        let range_m = trial.farthest_m();
        let senses = trial.sense_layouts().into_iter().map(|(name, layout)| StageSense {
            name,
            rays_rad: layout.sweep.map(|sweep| {
                let steps = layout.floats().saturating_sub(1) as f64;
                [sweep.from_rad, sweep.from_rad + sweep.step_rad * steps]
            }),
            mount_m: layout.sweep.map_or([0.0; 2], |sweep| sweep.mount_m),
        });
        let stage = Stage::of_team((&trial.deployment, &*trial.scenario), trial.physics.wall_radius_m, range_m);
        let stage = Stage { senses: senses.collect(), ..stage };
        stage.with_layouts(&trial.layouts, trial.scenario.arena())
    }

    /// Returns the stage of a team with this deployment and scenario. `hull_m` is the radius of a robot's hull \[m\],
    /// and `range_m` the range within which robots use each other's messages \[m\], infinite if it is unlimited or
    /// unknown. Senses, and what is drawn for each episode, are left out.
    pub fn of_team((deployment, scenario): (&Deployment, &dyn Scenario), hull_m: f32, range_m: f32) -> Stage {
        let arena = scenario.arena();
        let routes = Routes::of(deployment);
        Stage {
            scenario: scenario.name().to_owned(),
            mode: deployment.mode.clone(),
            hosts: deployment.hosts.iter().map(|host| host.name.clone()).collect(),
            homes: RobotId::team(deployment.robots).map(|robot| routes.agent_host(robot)).collect(),
            robots: deployment.robots,
            half_extent: arena.half_extent.to_array(),
            walls: arena.keep_outs.iter().map(KeepOut::solid).collect(),
            drawn: Vec::new(),
            movers: Vec::new(),
            waypoints: Vec::new(),
            unlabelled: scenario.goals().are_unlabelled(),
            hull_m,
            range_m: Some(range_m).filter(|range_m| range_m.is_finite()),
            senses: Vec::new(),
        }
    }

    /// Returns the stage with what the layouts of a scenario with the arena `arena` have drawn for each episode.
    pub fn with_layouts(self, layouts: &Layouts, arena: &Arena) -> Stage {
        let (drawn, movers, waypoints) = (layouts.drawn_blocks(), layouts.movers(arena), layouts.waypoints());
        Stage { drawn, movers, waypoints, ..self }
    }

    /// Returns the walls and obstacles in the episode with this index, from zero \[m\], world frame.
    pub fn walls_in(&self, episode: u32) -> &[Solid] {
        self.drawn.get(episode as usize).unwrap_or(&self.walls)
    }

    /// Returns the stage as MCAP metadata of a record.
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let text = serde_json::to_string(self).expect("a stage is JSON");
        BTreeMap::from([(ENTRY.to_owned(), text)])
    }

    /// Reads the stage from the MCAP metadata of a record; `None` if it is something else.
    pub fn of_metadata(metadata: &BTreeMap<String, String>) -> Option<Stage> {
        serde_json::from_str(metadata.get(ENTRY)?).ok()
    }
}
