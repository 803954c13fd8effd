//! Tables of the reference runs, as CSV with a head.

use std::collections::HashMap;
use std::path::PathBuf;

use crate::skip::skip;

/// Row of a table, by the names of its columns.
pub struct Row(HashMap<String, String>);

impl Row {
    pub fn text(&self, column: &str) -> &str {
        self.0.get(column).unwrap_or_else(|| panic!("the table has no column {column}"))
    }

    pub fn number(&self, column: &str) -> f64 {
        self.text(column).parse().unwrap_or_else(|_| panic!("{column} is '{}'", self.text(column)))
    }
}

/// Returns the folder of the tables; `None` if there is none here.
pub fn folder() -> Option<PathBuf> {
    let near = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/radio/data");
    let folder = std::env::var_os("MURMURATE_RADIO_DATA").map_or(near, PathBuf::from);
    folder.is_dir().then_some(folder)
}

/// Returns the rows of a table; none if it is not here, which is said.
pub fn rows(name: &str) -> Vec<Row> {
    let Some(folder) = folder() else {
        skip("ns3", &format!("there is no {name} at ../shared/radio/data or MURMURATE_RADIO_DATA"));
        return Vec::new();
    };
    let text = std::fs::read_to_string(folder.join(name)).expect("a table of the folder");
    let mut lines = text.lines();
    let head = cells(lines.next().expect("a head"));
    lines.map(|line| Row(head.iter().cloned().zip(cells(line)).collect())).collect()
}

/// Returns the positions of a place \[m\].
pub fn places(name: &str) -> Vec<[f32; 2]> {
    let path = folder().expect("a folder with tables").join("pos").join(format!("{name}.txt"));
    let text = std::fs::read_to_string(path).expect("a place of the folder");
    let numbers = |line: &str| line.split_whitespace().map(|number| number.parse().expect("a number")).collect();
    text.lines().map(numbers).map(|pair: Vec<f32>| [pair[0], pair[1]]).collect()
}

fn cells(line: &str) -> Vec<String> {
    let mut all = vec![String::new()];
    let mut quoted = false;
    for char in line.chars() {
        match char {
            '"' => quoted = !quoted,
            ',' if !quoted => all.push(String::new()),
            char => all.last_mut().expect("a cell").push(char),
        }
    }
    all
}
