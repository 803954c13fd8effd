//! Gradient of the difference between a policy's actions and the expert's, over recorded steps.

use super::config::Imitation;
use super::episode::{Setting, TaughtEpisode, limited, write_features};
use super::graph::Graph;
use super::network::Space;
use murmurate::messages::geometry::Vec2;
use murmurate::observation::Observation;
use murmurate::policy::hops::entry;

/// Steps of an episode that are learnt together.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Index of the episode among those of the iteration.
    pub episode: usize,
    /// First step.
    pub begin: usize,
}

/// Buffers and results of one part of a minibatch.
#[derive(Debug, Default)]
pub struct Shard {
    graph: Graph<f32>,
    space: Space<f32>,
    /// Expert's acceleration of each node \[m/s²\]; `None` for a node that is not learnt.
    expert: Vec<Option<[f32; 2]>>,
    d_outputs: Vec<f32>,
    /// Gradient of the loss.
    pub gradient: Vec<f32>,
    /// Sum of the squared differences from the expert's actions, over nodes and axes.
    pub loss: f32,
    /// Number of nodes that were learnt.
    pub learnt: usize,
}

impl Shard {
    /// Computes the gradient of the loss of some windows.
    pub fn learn(&mut self, setting: &Setting, imitation: &Imitation, episodes: &[TaughtEpisode], windows: &[Window]) {
        self.gather(setting, imitation, episodes, windows);
        let Setting { network, parameters, .. } = *setting;
        let Shard { graph, space, expert, d_outputs, gradient, loss, learnt } = self;
        gradient.clear();
        gradient.resize(parameters.len(), 0.0);
        (*loss, *learnt) = (0.0, 0);
        if graph.nodes() == 0 {
            return;
        }
        network.forward(parameters, graph, space);
        d_outputs.clear();
        d_outputs.resize(space.outputs().len(), 0.0);
        let width = network.outputs();
        let rows = space.outputs().chunks_exact(width).zip(d_outputs.chunks_exact_mut(width));
        for ((output, d), expert) in rows.zip(expert.iter()) {
            let Some(expert) = expert else { continue };
            *learnt += 1;
            for axis in 0..2 {
                let (error, slope) = difference(output[axis], expert[axis]);
                *loss += error * error;
                d[axis] = 2.0 * slope;
            }
        }
        network.backward(parameters, graph, d_outputs, space, gradient);
    }

    /// Makes the graph of some windows.
    fn gather(&mut self, setting: &Setting, imitation: &Imitation, episodes: &[TaughtEpisode], windows: &[Window]) {
        let Shard { graph, expert, .. } = self;
        let (manifest, robots) = (setting.manifest, setting.scenario.robots());
        graph.clear();
        expert.clear();
        let mut edge = vec![0.0; setting.network.edge()];
        for Window { episode, begin } in windows {
            let steps = &episodes[*episode].steps;
            let from = begin.saturating_sub(imitation.lookback);
            let base = graph.nodes();
            for at in from..(begin + imitation.window).min(steps.len()) {
                let step = &steps[at];
                for robot in 0..robots {
                    let motion = step.motion[robot];
                    let seen = Observation::new(motion, Vec2::zeros());
                    entry::append(&manifest.observation, &seen, &mut graph.observations);
                    let range = step.first[robot] as usize..step.first[robot + 1] as usize;
                    for (sender, age) in &step.heard[range] {
                        let Some(sent) = at.checked_sub(usize::from(*age)).filter(|sent| *sent >= from) else {
                            continue;
                        };
                        let sender = usize::from(*sender);
                        write_features(manifest, &motion, (&steps[sent].motion[sender], *age), &mut edge);
                        graph.edges.extend_from_slice(&edge);
                        let node = base + (sent - from) * robots + sender;
                        graph.sender.push(u32::try_from(node).expect("a batch has far fewer nodes"));
                    }
                    graph.end_node();
                    expert.push((at >= *begin).then(|| step.expert[robot]));
                }
            }
        }
    }
}

/// Returns the difference of an action's component, once it is limited, from the expert's, and half of the derivative
/// of its square. Beyond the limit there is a derivative only toward the expert's action: farther out nothing changes.
fn difference(output: f32, expert: f32) -> (f32, f32) {
    let error = limited(output) - expert;
    let outward = (limited(output) != output) && (output > 0.0) != (error > 0.0);
    (error, if outward { 0.0 } else { error })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_the_limit_only_the_way_back_counts() {
        assert_eq!(difference(0.5, 0.2), (0.3, 0.3));
        assert_eq!(difference(3.0, 1.0), (0.0, 0.0));
        assert_eq!(difference(3.0, 0.4), (0.6, 0.6), "it comes back");
        assert_eq!(difference(-2.0, -1.0), (0.0, 0.0));
    }
}
