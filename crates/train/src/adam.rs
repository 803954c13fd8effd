//! The Adam optimiser (Kingma and Ba, arXiv 1412.6980, algorithm 1), and gradient clipping by norm.

use serde::{Deserialize, Serialize};

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

/// State of the Adam optimiser: estimates of the first and second moments of each gradient entry.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
    steps: i32,
}

impl Adam {
    /// Returns the initial state for this number of parameters: zero moments, no steps.
    pub fn new(parameters: usize) -> Adam {
        Adam { first: vec![0.0; parameters], second: vec![0.0; parameters], steps: 0 }
    }

    /// Whether the state has this number of parameters.
    pub fn fits(&self, parameters: usize) -> bool {
        self.first.len() == parameters && self.second.len() == parameters
    }

    /// Updates `parameters` in place by one step against `gradient`, which has one number per parameter.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f32) {
        self.steps += 1;
        let (correct_1, correct_2) = (1.0 - BETA_1.powi(self.steps), 1.0 - BETA_2.powi(self.steps));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, gradient), (first, second)) in parameters.iter_mut().zip(gradient).zip(moments) {
            *first = BETA_1 * *first + (1.0 - BETA_1) * gradient;
            *second = BETA_2 * *second + (1.0 - BETA_2) * gradient * gradient;
            *parameter -= learning_rate * (*first / correct_1) / ((*second / correct_2).sqrt() + EPSILON);
        }
    }
}

/// Scales a gradient in place so that its Euclidean norm is at most `max`. Returns the norm before scaling.
pub fn clip(gradient: &mut [f32], max: f32) -> f32 {
    let norm = gradient.iter().map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>().sqrt() as f32;
    if norm > max {
        gradient.iter_mut().for_each(|g| *g *= max / norm);
    }
    norm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_minimises_a_quadratic_function() {
        let (mut adam, mut at) = (Adam::new(2), [3.0f32, -2.0]);
        for _ in 0..2000 {
            let mut gradient = [at[0] - 1.0, 10.0 * (at[1] - 0.5)];
            clip(&mut gradient, 1.0);
            adam.step(&mut at, &gradient, 0.01);
        }
        assert!((at[0] - 1.0).abs() < 1e-2 && (at[1] - 0.5).abs() < 1e-2, "{at:?}");
    }

    #[test]
    fn a_long_gradient_is_clipped_and_a_short_one_is_not() {
        let mut long = [3.0, 4.0];
        assert!((clip(&mut long, 0.5) - 5.0).abs() < 1e-6);
        assert!((long[0] - 0.3).abs() < 1e-6 && (long[1] - 0.4).abs() < 1e-6);
        let mut short = [0.1, 0.2];
        clip(&mut short, 0.5);
        assert_eq!(short, [0.1, 0.2]);
    }
}
