//! Places of the stations of a network study, for radios on which distances matter.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use murmurate::config::ConfigError;

/// Places of the stations of a network study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Places {
    /// In a line, with this distance between neighbours \[m\].
    Line(f32),
    /// On a circle with this radius \[m\].
    Ring(f32),
    /// In a square grid, row after row, with this distance between neighbours \[m\].
    Grid(f32),
    /// At these points \[m\], one for each station.
    Given(Vec<[f32; 2]>),
}

impl Places {
    /// Reads places from text with one station a line, x and y \[m\].
    ///
    /// # Errors
    /// If a line is no pair of numbers; it is named.
    pub fn from_text(text: &str) -> Result<Places, ConfigError> {
        let of_line = |(at, line): (usize, &str)| {
            let numbers: Vec<f32> = line.split_whitespace().filter_map(|number| number.parse().ok()).collect();
            match numbers[..] {
                [x, y] if x.is_finite() && y.is_finite() => Ok([x, y]),
                _ => Err(ConfigError::field("places", format!("line {} is not x and y [m]", at + 1))),
            }
        };
        text.lines()
            .enumerate()
            .filter(|(_, line)| !line.trim().is_empty())
            .map(of_line)
            .collect::<Result<_, _>>()
            .map(Places::Given)
    }

    /// Returns the places of `stations` stations \[m\].
    pub fn of(&self, stations: u16) -> Vec<[f32; 2]> {
        let side = f32::from(stations).sqrt().ceil().max(1.0) as u16;
        let place = |station: u16| match self {
            Places::Line(gap_m) => [f32::from(station) * gap_m, 0.0],
            Places::Ring(radius_m) => {
                let (sin, cos) = libm::sincosf(std::f32::consts::TAU * f32::from(station) / f32::from(stations));
                [radius_m * cos, radius_m * sin]
            }
            Places::Grid(gap_m) => [f32::from(station % side) * gap_m, f32::from(station / side) * gap_m],
            Places::Given(all) => all[usize::from(station)],
        };
        (0..stations).map(place).collect()
    }

    /// Checks that each of `stations` stations has a place.
    ///
    /// # Errors
    /// If not, or if a distance is none.
    pub fn check(&self, stations: u16) -> Result<(), ConfigError> {
        match self {
            Places::Line(gap_m) | Places::Ring(gap_m) | Places::Grid(gap_m) if !(0.0..=1e6).contains(gap_m) => {
                Err(ConfigError::field("places", format!("{gap_m} m is not a distance")))
            }
            Places::Given(all) if all.len() != usize::from(stations) => {
                Err(ConfigError::field("places", format!("there are {} for {stations} stations", all.len())))
            }
            _ => Ok(()),
        }
    }
}

impl FromStr for Places {
    type Err = String;

    /// Reads `line:GAP`, `ring:RADIUS` or `grid:GAP` \[m\].
    fn from_str(text: &str) -> Result<Places, String> {
        let (form, metres) = text.split_once(':').ok_or_else(|| format!("'{text}' has no distance"))?;
        let metres: f32 = metres.parse().map_err(|_| format!("'{metres}' is not a distance [m]"))?;
        match form {
            "line" => Ok(Places::Line(metres)),
            "ring" => Ok(Places::Ring(metres)),
            "grid" => Ok(Places::Grid(metres)),
            _ => Err(format!("there is no '{form}'; there are line, ring and grid")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_read_and_counted() {
        let read = |text: &str| text.parse::<Places>().expect("places");
        assert_eq!(read("line:25").of(3), [[0.0, 0.0], [25.0, 0.0], [50.0, 0.0]]);
        assert_eq!(read("grid:2").of(5)[4], [2.0, 2.0]);
        let ring = read("ring:10").of(4);
        assert!((ring[1][1] - 10.0).abs() < 1e-5 && ring[1][0].abs() < 1e-5, "{ring:?}");
        let given = Places::from_text("0 1\n\n2.5 -3\n").expect("places");
        assert_eq!(given.of(2), [[0.0, 1.0], [2.5, -3.0]]);
        assert!(given.check(3).unwrap_err().to_string().contains("there are 2 for 3 stations"));
        assert!(Places::from_text("0 1\n0").unwrap_err().to_string().contains("line 2"));
        for wrong in ["line", "line:x", "star:3"] {
            assert!(wrong.parse::<Places>().is_err(), "{wrong}");
        }
        assert!(read("line:-1").check(3).is_err());
    }
}
