//! Check of a policy on made-up inputs, before a robot moves by it: what its files cannot say, such as what it computes
//! without a neighbour.

use std::ops::Range;
use std::sync::Arc;

use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::MAX_FEATURE;
use murmurate::random::{self, Seed, Stream};

use crate::contract::Pad;
use crate::engine::Array;
use crate::network::{Graph, Network, Output, Source};
use crate::parts::Refused;
use crate::structure::Role;

/// Largest difference between outputs that have to be equal but for rounding; relative for outputs above 1.
const TOLERANCE: f32 = 1e-4;
/// Number of steps in which the state is fed back.
const STEPS: usize = 2000;
/// Standard deviation of made-up observations, messages and states.
const DEVIATION: f32 = 0.5;

/// Runs the graphs of a policy on made-up inputs: for one robot and three, with each number of neighbours and with
/// none, and step after step with the state. Returns remarks, which are no faults.
///
/// # Errors
/// A graph does not run, or it gives what is not finite, of another shape, or different for equal inputs. Robots of one
/// call affect each other, or what stands in an empty place changes the outputs.
pub fn check(network: &Arc<Network>) -> Result<Vec<String>, Refused> {
    let mut remarks = Vec::new();
    for graph in &network.graphs {
        let place = graph.role.field();
        Checked { network, graph }
            .run_all(&mut remarks)
            .map_err(|why| Refused::Disagree(format!("its {place}: {why}")))?;
    }
    Ok(remarks)
}

/// Graph under check.
struct Checked<'a> {
    network: &'a Network,
    graph: &'a Graph,
}

impl Checked<'_> {
    fn has(&self, source: &Source) -> bool {
        self.graph.inputs.iter().any(|(_, other)| other == source)
    }

    /// Makes up inputs for `robots` robots with `places` places for neighbours, all of which are taken.
    fn draw(&self, robots: usize, places: usize, stream: &mut Stream) -> Vec<Array> {
        let contract = &self.network.contract;
        let mut input = |source: &Source| {
            let shape = match source {
                Source::Observation(_, axes) => [&[robots], axes.as_slice()].concat(),
                Source::Messages => vec![robots, places, contract.message.floats],
                Source::Edges => vec![robots, places, contract.edge_floats()],
                Source::Heard => vec![robots, places],
                Source::OwnMessage => vec![robots, contract.message.floats],
                Source::State => vec![robots, contract.state_floats()],
                Source::Id(floats) => vec![robots, *floats],
            };
            let count = shape.iter().product();
            let values = match source {
                Source::Heard => vec![1.0; count],
                Source::Id(floats) => self.ids(0..robots, *floats),
                _ => (0..count).map(|_| DEVIATION * random::normals(stream)[0] as f32).collect(),
            };
            Array { shape, values }
        };
        self.graph.inputs.iter().map(|(_, source)| input(source)).collect()
    }

    /// Returns the input `id` of these robots, with `floats` floats each. Places beyond the largest team begin anew.
    fn ids(&self, robots: Range<usize>, floats: usize) -> Vec<f32> {
        let said = self.network.contract.robots.as_ref().expect("a graph with an id has a table of robots");
        let most = self.network.most_robots.unwrap_or(usize::MAX);
        let row = |robot: usize| {
            let mut row = vec![0.0; floats];
            said.write(RobotId((robot % most) as u16), &mut row).expect("it is a place of the largest team");
            row
        };
        robots.flat_map(row).collect()
    }

    /// Runs the graph for each robot of the largest team.
    fn each_robot(&self, inputs: &[Array]) -> Result<(), String> {
        for robot in 0..self.network.most_robots.unwrap_or(1) {
            let inputs = self.with(inputs.to_vec(), |source, values| {
                if let Source::Id(floats) = source {
                    values.copy_from_slice(&self.ids(robot..robot + 1, *floats));
                }
            });
            self.run(&inputs, 1, &format!("the id of robot {robot}"))?;
        }
        Ok(())
    }

    /// Runs the graph, and checks that its outputs are finite and have one row for each robot. `what` describes the
    /// inputs.
    fn run(&self, inputs: &[Array], robots: usize, what: &str) -> Result<Vec<Array>, String> {
        let outputs = self.graph.engine.run(inputs).map_err(|why| format!("with {what}: {why}"))?;
        for ((name, output, floats), array) in self.graph.outputs.iter().zip(&outputs) {
            if array.shape != [robots, *floats] {
                let found = &array.shape;
                return Err(format!("with {what} its output '{name}' is {found:?}: [{robots}, {floats}] is expected"));
            }
            if !array.values.iter().all(|value| value.is_finite()) {
                return Err(format!("with {what} its output '{name}' is not finite"));
            }
            let largest = array.values.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
            if *output == Output::Message && largest > MAX_FEATURE {
                return Err(format!("with {what} its message is up to {largest:e}: at most {MAX_FEATURE:e} is sent"));
            }
        }
        Ok(outputs)
    }

    fn run_all(&self, remarks: &mut Vec<String>) -> Result<(), String> {
        let mut stream = Seed::of_run(1).stream("policy/check");
        let contract = &self.network.contract;
        let most = contract.max_neighbours;
        let counts = if contract.pad == Pad::Max { vec![most] } else { (1..=most).collect() };
        let hears = self.has(&Source::Heard);
        for &places in if hears { &counts } else { &counts[..1] } {
            let what = if hears { format!("{places} places for neighbours") } else { "one robot".to_owned() };
            self.run(&self.draw(1, places, &mut stream), 1, &what)?;
        }
        let places = if contract.pad == Pad::Max { most } else { 2.min(most) };
        let inputs = self.draw(1, places, &mut stream);
        let outputs = self.run(&inputs, 1, "the inputs of the check")?;
        if self.run(&inputs, 1, "the inputs of the check")? != outputs {
            return Err("equal inputs give different outputs".to_owned());
        }
        self.each_robot(&inputs)?;
        self.alone(places, &mut stream, remarks)?;
        if hears {
            self.without_neighbours(counts[0], &mut stream)?;
            self.order(&inputs, &outputs, places, remarks)?;
        }
        if self.has(&Source::State) && self.graph.outputs.iter().any(|(_, output, _)| *output == Output::State) {
            self.state(inputs, &outputs, remarks)?;
        }
        Ok(())
    }

    /// Checks that a robot gets the same outputs alone and in a call of several, where the graph takes several.
    fn alone(&self, places: usize, stream: &mut Stream, remarks: &mut Vec<String>) -> Result<(), String> {
        let robots = 3;
        let inputs = self.draw(robots, places, stream);
        let together = match self.run(&inputs, robots, "three robots in one call") {
            Ok(outputs) => outputs,
            Err(why) => {
                remarks.push(format!("it runs for one robot a call only ({why})"));
                return Ok(());
            }
        };
        for robot in 0..robots {
            let row = |array: &Array| {
                let length = array.values.len() / robots;
                let values = array.values[robot * length..][..length].to_vec();
                Array { shape: [&[1], &array.shape[1..]].concat(), values }
            };
            let inputs: Vec<Array> = inputs.iter().map(row).collect();
            let alone = self.run(&inputs, 1, "one robot")?;
            let rows: Vec<Array> = together.iter().map(row).collect();
            let off = difference(&alone, &rows);
            if off > TOLERANCE {
                return Err(format!(
                    "robots of one call affect each other: alone a robot's outputs differ by {off:.1e} (a batch \
                     normalisation in training mode, or a sum over robots)"
                ));
            }
        }
        Ok(())
    }

    /// Checks that what stands in an empty place changes nothing.
    fn without_neighbours(&self, places: usize, stream: &mut Stream) -> Result<(), String> {
        let junk: Vec<Array> = self.with(self.draw(1, places, stream), |source, values| {
            if *source == Source::Heard {
                values.fill(0.0);
            }
        });
        let none = self.with(junk.clone(), |source, values| {
            if matches!(source, Source::Messages | Source::Edges) {
                values.fill(0.0);
            }
        });
        let zeros = self.run(&none, 1, "no neighbour")?;
        let off = difference(&zeros, &self.run(&junk, 1, "no neighbour, and numbers in the empty places")?);
        if off > TOLERANCE {
            return Err(format!("what stands in places where 'heard' is 0 changes its outputs by {off:.1e}"));
        }
        Ok(())
    }

    /// Remarks whether the order of the neighbours matters.
    fn order(
        &self,
        inputs: &[Array],
        outputs: &[Array],
        places: usize,
        remarks: &mut Vec<String>,
    ) -> Result<(), String> {
        let turned = self.with(inputs.to_vec(), |source, values| {
            if matches!(source, Source::Messages | Source::Edges) {
                let length = values.len() / places;
                let rows: Vec<f32> = values.chunks_exact(length).rev().flatten().copied().collect();
                values.copy_from_slice(&rows);
            }
        });
        let off = difference(outputs, &self.run(&turned, 1, "neighbours in another order")?);
        if off > TOLERANCE {
            remarks.push(format!(
                "the order of the neighbours changes its outputs by {off:.1e}: they come by robots' ids"
            ));
        }
        Ok(())
    }

    /// Feeds the state back for many steps, and checks that it stays finite.
    fn state(&self, mut inputs: Vec<Array>, first: &[Array], remarks: &mut Vec<String>) -> Result<(), String> {
        let index = |outputs: &[Array]| -> Vec<f32> {
            let at = self.graph.outputs.iter().position(|(_, output, _)| *output == Output::State);
            outputs[at.expect("it has one")].values.clone()
        };
        let mut outputs = first.to_vec();
        let mut moved = false;
        for step in 1..=STEPS {
            let next = index(&outputs);
            inputs = self.with(inputs, |source, values| {
                if *source == Source::State {
                    values.copy_from_slice(&next);
                }
            });
            outputs = self.run(&inputs, 1, &format!("its own state after {step} steps"))?;
            moved |= difference(&outputs, first) > 0.0;
        }
        if !moved && self.graph.role != Role::Encode {
            remarks.push("its state changes nothing".to_owned());
        }
        let largest = index(&outputs).iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        remarks.push(format!("its state is at most {largest:.2} after {STEPS} steps of equal inputs"));
        Ok(())
    }

    /// Returns inputs that `change` has changed, by what each is.
    fn with(&self, mut inputs: Vec<Array>, change: impl Fn(&Source, &mut [f32])) -> Vec<Array> {
        for ((_, source), array) in self.graph.inputs.iter().zip(&mut inputs) {
            change(source, &mut array.values);
        }
        inputs
    }
}

/// Returns the largest difference of all outputs, relative for those above 1.
fn difference(one: &[Array], other: &[Array]) -> f32 {
    let values = |arrays: &[Array]| arrays.iter().flat_map(|array| array.values.clone()).collect::<Vec<f32>>();
    let relative = |(a, b): (&f32, &f32)| (a - b).abs() / a.abs().max(b.abs()).max(1.0);
    values(one).iter().zip(&values(other)).map(relative).fold(0.0, f32::max)
}
