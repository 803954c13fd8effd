//! Axes of a sweep as `--axis` gives them: a flag of `sim`, or a field in the file of a flag, with its values.

use std::str::FromStr;

use murmurate_study::sweep::Axis;

use super::given::Given;
use super::place::Place;
use crate::sim::changes::FILES;

/// Largest number of values on an axis.
const MOST_VALUES: usize = 200;

/// Flags that are no axes: points are compared on equal numbers of episodes.
const NO_AXES: [&str; 3] = ["episodes", "episodes-file", "repeats"];

/// Axis of `--axis`: its quantity and its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GivenAxis {
    /// Quantity that the axis varies.
    pub place: Place,
    /// Name and values.
    pub axis: Axis,
}

impl FromStr for GivenAxis {
    type Err = String;

    fn from_str(text: &str) -> Result<GivenAxis, String> {
        let wrong = || format!("'{text}' is not NAME=VALUE,VALUE,..., such as robots=6,8,10");
        let (name, values) = text.split_once('=').ok_or_else(wrong)?;
        let name = name.trim_start_matches("--").trim();
        if NO_AXES.contains(&name) {
            return Err(format!("{name} is no axis: points are compared on equal numbers of episodes"));
        }
        let place = place_of(name)?;
        if values.contains(char::is_control) {
            return Err(format!("{name}: a value has a control character"));
        }
        let values = split(values).ok_or_else(|| format!("{name}: a bracket or quote is not closed"))?;
        let bare = |value: String| value.trim_matches('"').to_owned();
        // A flag's value is text already.
        let values: Vec<String> =
            if matches!(place, Place::Flag(_)) { values.into_iter().map(bare).collect() } else { values };
        if values.iter().any(String::is_empty) {
            return Err(wrong());
        }
        if values.len() > MOST_VALUES {
            return Err(format!("{} values; the limit is {MOST_VALUES}", values.len()));
        }
        if let Some((_, twice)) = values.iter().enumerate().find(|(at, value)| values[..*at].contains(value)) {
            return Err(format!("the value {twice} is given twice"));
        }
        Ok(GivenAxis { place, axis: Axis { name: name.to_owned(), values } })
    }
}

/// Returns the quantity of an axis with this name.
fn place_of(name: &str) -> Result<Place, String> {
    let place = Place::of(name);
    match &place {
        Place::Field { flag, field } => {
            if !FILES.contains(&flag.as_str()) || field.iter().any(String::is_empty) {
                let files = FILES.map(|flag| format!("{flag}.FIELD")).join(", ");
                return Err(format!("there is no '{name}'; fields of files are {files}"));
            }
        }
        Place::Flag(_) if !Given::exists(name) => {
            let names = Given::names().into_iter().filter(|name| !NO_AXES.contains(&name.as_str()));
            return Err(format!("sim has no flag '--{name}'; there are: {}", names.collect::<Vec<_>>().join(", ")));
        }
        Place::Flag(_) => {}
    }
    Ok(place)
}

/// Splits values at the commas outside of brackets and quotes; `None` if one of these is left open.
fn split(text: &str) -> Option<Vec<String>> {
    let (mut values, mut depth, mut quoted) = (vec![String::new()], 0_i32, false);
    for sign in text.chars() {
        match sign {
            '"' => quoted = !quoted,
            '[' | '{' if !quoted => depth += 1,
            ']' | '}' if !quoted => depth -= 1,
            _ => {}
        }
        if sign == ',' && depth == 0 && !quoted {
            values.push(String::new());
        } else {
            values.last_mut().expect("there is a first one").push(sign);
        }
    }
    (depth == 0 && !quoted).then(|| values.into_iter().map(|value| value.trim().to_owned()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_a_flag_or_a_field_of_a_file_with_different_values() {
        let axis: GivenAxis = "robots=6,7, 8".parse().expect("it is an axis");
        assert_eq!(
            (axis.place, axis.axis.values),
            (Place::Flag("robots".to_owned()), ["6", "7", "8"].map(str::to_owned).to_vec())
        );
        let axis: GivenAxis = "scenario.walls.0.at=[1,2],[3,4]".parse().expect("it is an axis");
        assert_eq!(axis.axis.values, ["[1,2]", "[3,4]"]);
        let field = ["walls", "0", "at"].map(str::to_owned).to_vec();
        assert_eq!(axis.place, Place::Field { flag: "scenario".to_owned(), field });
        let quoted: GivenAxis = "policy=\"a,b\",c".parse().expect("it is an axis");
        assert_eq!(quoted.axis.values, ["a,b", "c"]);
        for (wrong, says) in [
            ("robots", "is not NAME=VALUE"),
            ("robots=", "is not NAME=VALUE"),
            ("robots=5,,6", "is not NAME=VALUE"),
            ("robots=5,5", "5 is given twice"),
            ("robot=5", "sim has no flag '--robot'; there are: mode, "),
            ("episodes=5", "equal numbers of episodes"),
            ("policy.hold_s=1", "there is no 'policy.hold_s'"),
            ("radio.=1", "there is no 'radio.'"),
            ("radio.noise=[1,2", "is not closed"),
            ("robots=1]", "is not closed"),
            ("radio.retries=3\nx = 1", "control character"),
        ] {
            let error = wrong.parse::<GivenAxis>().expect_err(wrong);
            assert!(error.contains(says) && !error.contains('\n'), "{wrong}: {error}");
        }
    }
}
