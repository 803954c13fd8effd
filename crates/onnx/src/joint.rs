//! Calls of the robots of one Agent that are made as one, with the robots as first axis of all arrays.

use std::collections::BTreeMap;

use murmurate::messages::ids::RobotId;

use crate::engine::Array;
use crate::network::Port;

/// Calls of one role that wait to be made together, and the outputs of those that were.
#[derive(Debug, Default)]
pub struct Joint {
    waiting: BTreeMap<RobotId, Vec<Array>>,
    answers: BTreeMap<RobotId, Result<Vec<Array>, String>>,
}

impl Joint {
    /// Keeps the call of a robot, whose arrays have one row each. It replaces one of that robot that still waits, and
    /// its last outputs.
    pub fn ask(&mut self, robot: RobotId, inputs: &[Array]) {
        self.answers.remove(&robot);
        self.waiting.insert(robot, inputs.to_vec());
    }

    /// Returns the outputs of the robot's call; `None` if it has made none. If it waits, all that wait are made by
    /// `run`, whose arrays have the robots in the order of their ids. `ports` are the inputs. An error is that of all.
    pub fn answer(
        &mut self,
        robot: RobotId,
        ports: &[Port],
        run: impl FnOnce(&[Array]) -> Result<Vec<Array>, String>,
    ) -> Option<Result<Vec<Array>, String>> {
        if self.waiting.contains_key(&robot) {
            let waiting = std::mem::take(&mut self.waiting);
            let rows: Vec<&Vec<Array>> = waiting.values().collect();
            let outputs = run(&stacked(&rows, ports));
            for (at, robot) in waiting.keys().enumerate() {
                let own = outputs.as_ref().map(|all| all.iter().map(|array| row(array, at, waiting.len())).collect());
                self.answers.insert(*robot, own.map_err(Clone::clone));
            }
        }
        self.answers.remove(&robot)
    }
}

/// Returns the arrays of several calls as those of one. A robot with fewer places for neighbours than another has zeros
/// in those that it lacks.
fn stacked(rows: &[&Vec<Array>], ports: &[Port]) -> Vec<Array> {
    let stack = |(at, port): (usize, &Port)| {
        let all = || rows.iter().map(|row| &row[at]);
        let mut shape = all().next().map(|first| first.shape.clone()).unwrap_or_default();
        shape[0] = rows.len();
        if port.of_neighbours {
            shape[1] = all().map(|array| array.shape[1]).max().unwrap_or(1);
        }
        let floats: usize = shape[1..].iter().product();
        let mut values = Vec::with_capacity(rows.len() * floats);
        for (row, array) in all().enumerate() {
            values.extend_from_slice(&array.values);
            values.resize((row + 1) * floats, 0.0);
        }
        Array { shape, values }
    };
    ports.iter().enumerate().map(stack).collect()
}

/// Returns the row `at` of an output with so many rows.
fn row(array: &Array, at: usize, rows: usize) -> Array {
    let floats = array.values.len() / rows;
    let mut shape = array.shape.clone();
    shape[0] = 1;
    Array { shape, values: array.values[at * floats..(at + 1) * floats].to_vec() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array(shape: &[usize], values: &[f32]) -> Array {
        Array { shape: shape.to_vec(), values: values.to_vec() }
    }

    fn ports() -> [Port; 2] {
        let port = |name: &str, of_neighbours, axes: &[usize]| Port {
            name: name.to_owned(),
            of_neighbours,
            axes: axes.to_vec(),
        };
        [port("goal", false, &[2]), port("messages", true, &[2])]
    }

    #[test]
    fn calls_that_wait_are_made_once_by_robot_and_with_zeros_for_missing_neighbours() {
        let mut joint = Joint::default();
        joint.ask(RobotId(4), &[array(&[1, 2], &[4.0, 5.0]), array(&[1, 1, 2], &[1.0, 2.0])]);
        joint.ask(RobotId(1), &[array(&[1, 2], &[8.0, 8.0]), array(&[1, 2, 2], &[0.0; 4])]);
        joint.ask(RobotId(1), &[array(&[1, 2], &[6.0, 7.0]), array(&[1, 2, 2], &[3.0, 4.0, 5.0, 6.0])]);
        let run = |inputs: &[Array]| {
            assert_eq!(inputs[0], array(&[2, 2], &[6.0, 7.0, 4.0, 5.0]), "the newest, in the order of ids");
            assert_eq!(inputs[1], array(&[2, 2, 2], &[3.0, 4.0, 5.0, 6.0, 1.0, 2.0, 0.0, 0.0]));
            Ok(vec![array(&[2, 1], &[10.0, 40.0])])
        };
        assert_eq!(joint.answer(RobotId(0), &ports(), run), None, "it has not asked");
        assert_eq!(joint.answer(RobotId(4), &ports(), run), Some(Ok(vec![array(&[1, 1], &[40.0])])));
        let again = |_: &[Array]| -> Result<Vec<Array>, String> { unreachable!("it was made") };
        assert_eq!(joint.answer(RobotId(1), &ports(), again), Some(Ok(vec![array(&[1, 1], &[10.0])])));
        assert_eq!(joint.answer(RobotId(1), &ports(), again), None, "an answer is taken once");
    }

    #[test]
    fn an_error_is_that_of_all_who_wait_and_an_old_answer_is_not_that_of_a_new_call() {
        let mut joint = Joint::default();
        let inputs = [array(&[1, 2], &[0.0, 0.0]), array(&[1, 1, 2], &[0.0, 0.0])];
        [1, 2].iter().for_each(|robot| joint.ask(RobotId(*robot), &inputs));
        let failed = Some(Err("it has ended".to_owned()));
        assert_eq!(joint.answer(RobotId(1), &ports(), |_| Err("it has ended".to_owned())), failed);
        joint.ask(RobotId(2), &inputs);
        let sound = joint.answer(RobotId(2), &ports(), |inputs| Ok(vec![inputs[0].clone()]));
        assert_eq!(sound, Some(Ok(vec![inputs[0].clone()])));
    }
}
