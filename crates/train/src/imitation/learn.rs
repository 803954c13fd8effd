//! Gradient of the difference between a policy's actions and the expert's, over recorded steps.

use super::config::Imitation;
use super::episode::{Setting, TaughtEpisode, largest, limited};
use crate::batch::Batch;
use crate::graphs::Window;
use crate::network::Space;

/// Steps of an episode that are learnt together.
#[derive(Clone, Copy, Debug)]
pub struct Lesson {
    /// Index of the episode among those of the iteration.
    pub episode: usize,
    /// First step.
    pub begin: usize,
}

/// Buffers and results of one part of a minibatch.
#[derive(Debug, Default)]
pub struct Shard {
    batch: Batch<f32>,
    space: Space<f32>,
    d_outputs: Vec<f32>,
    /// Gradient of the loss.
    pub gradient: Vec<f32>,
    /// Sum of the squared differences from the expert's actions, over nodes and axes.
    pub loss: f32,
    /// Number of nodes that were learnt.
    pub learnt: usize,
}

impl Lesson {
    /// Returns the steps that are learnt, and those before them from which messages still count.
    fn window<'a>(&self, imitation: &Imitation, episodes: &'a [TaughtEpisode]) -> Window<'a> {
        let episode = &episodes[self.episode];
        let first = self.begin.saturating_sub(imitation.lookback);
        let steps = (self.begin + imitation.window).min(episode.steps()) - first;
        Window { graphs: &episode.graphs, first, steps, lookback: self.begin - first, every: 1 }
    }

    /// Returns the expert's actions in the steps that are learnt.
    fn expert<'a>(&self, imitation: &Imitation, episodes: &'a [TaughtEpisode]) -> &'a [[f32; 2]] {
        let episode = &episodes[self.episode];
        let end = (self.begin + imitation.window).min(episode.steps());
        &episode.expert[self.begin * episode.graphs.robots..end * episode.graphs.robots]
    }
}

impl Shard {
    /// Computes the gradient of the loss of some lessons.
    pub fn learn(&mut self, setting: &Setting, imitation: &Imitation, episodes: &[TaughtEpisode], lessons: &[Lesson]) {
        let Setting { network, parameters, manifest, units, .. } = *setting;
        let largest = largest(manifest) / units.action;
        let Shard { batch, space, d_outputs, gradient, loss, learnt } = self;
        gradient.clear();
        gradient.resize(parameters.len(), 0.0);
        (*loss, *learnt) = (0.0, 0);
        if lessons.is_empty() {
            return;
        }
        batch.gather(lessons.iter().map(|lesson| lesson.window(imitation, episodes)));
        network.forward(parameters, batch, space);
        d_outputs.clear();
        d_outputs.resize(space.outputs().len(), 0.0);
        let width = network.outputs();
        let rows = space.outputs().chunks_exact(width).zip(d_outputs.chunks_exact_mut(width));
        let experts = lessons.iter().flat_map(|lesson| lesson.expert(imitation, episodes));
        for ((output, d), expert) in rows.zip(experts) {
            *learnt += 1;
            for axis in 0..2 {
                let (error, slope) = difference(output[axis], expert[axis], largest);
                *loss += error * error;
                d[axis] = 2.0 * slope;
            }
        }
        network.backward(parameters, batch, d_outputs, space, gradient);
    }
}

/// Returns the difference of an action's component, once it is limited to what is `largest`, from the expert's, and
/// half of the derivative of its square. Beyond the limit there is a derivative only toward the expert's action:
/// farther out nothing changes.
fn difference(output: f32, expert: f32, largest: f32) -> (f32, f32) {
    let action = limited(output, largest);
    let error = action - expert;
    let outward = (action != output) && (output > 0.0) != (error > 0.0);
    (error, if outward { 0.0 } else { error })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_the_limit_only_the_way_back_counts() {
        assert_eq!(difference(0.5, 0.2, 1.0), (0.3, 0.3));
        assert_eq!(difference(3.0, 1.0, 1.0), (0.0, 0.0));
        assert_eq!(difference(3.0, 0.4, 1.0), (0.6, 0.6), "it comes back");
        assert_eq!(difference(-2.0, -1.0, 1.0), (0.0, 0.0));
    }
}
