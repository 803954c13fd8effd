//! Changes of fields in the files that flags of `sim` name, such as `radio.retries`, before they are read.

use std::path::Path;

use anyhow::Result;
use murmurate_robot::BadInput;
use murmurate_robot::output::read_text;
use toml::{Table, Value};

/// Flags that name a file (TOML) whose fields can be changed.
pub const FILES: [&str; 7] = ["conditions", "deployment", "faults", "radio", "roles", "scenario", "senses"];

/// Change of one field in the file of a flag.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// Flag that names the file, without `--`, one of [`FILES`].
    pub flag: String,
    /// Path of the field in the file; an element of a list has its index, from 0.
    pub field: Vec<String>,
    /// New value of the field.
    pub value: Value,
}

/// Changes of fields in files, in the order in which they are made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes(pub Vec<Change>);

impl Changes {
    /// Returns whether a field in the file of the flag `flag` (without `--`) changes.
    pub fn concern(&self, flag: &str) -> bool {
        self.0.iter().any(|change| change.flag == flag)
    }

    /// Returns the text of the file at `path`, which the flag `flag` names, with its changes. `what` is the noun for
    /// the file in errors.
    pub fn read(&self, flag: &str, path: &Path, what: &str) -> Result<String> {
        self.over(flag, read_text(path, what)?)
    }

    /// Returns a text of the file that the flag `flag` names, with its changes.
    pub fn over(&self, flag: &str, text: String) -> Result<String> {
        if !self.concern(flag) {
            return Ok(text);
        }
        // A file that is not TOML is reported where it is read.
        let Ok(table) = text.parse::<Table>() else { return Ok(text) };
        let mut root = Value::Table(table);
        for change in self.0.iter().filter(|change| change.flag == flag) {
            set(&mut root, change).map_err(|why| BadInput(format!("{flag}.{}: {why}", change.field.join("."))))?;
        }
        Ok(toml::to_string(&root).expect("a table is TOML"))
    }
}

/// Sets a field of `root`, a table, and makes the tables on its way that are missing.
fn set(root: &mut Value, change: &Change) -> Result<(), String> {
    let place = change.field.iter().try_fold(root, |at, name| step(at, name))?;
    *place = change.value.clone();
    Ok(())
}

fn step<'a>(at: &'a mut Value, name: &str) -> Result<&'a mut Value, String> {
    match at {
        Value::Table(table) => Ok(table.entry(name).or_insert_with(|| Value::Table(Table::new()))),
        Value::Array(list) => {
            let length = list.len();
            let index = name.parse::<usize>().ok().filter(|index| *index < length);
            let why = || format!("'{name}' is not an index of its list, which has {length} elements");
            index.map(|index| &mut list[index]).ok_or_else(why)
        }
        _ => Err(format!("'{name}' is not a part of a single value")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(field: &str, value: &str) -> Changes {
        let value = format!("v = {value}").parse::<Table>().expect("it is TOML")["v"].clone();
        let field = field.split('.').map(str::to_owned).collect();
        Changes(vec![Change { flag: "radio".to_owned(), field, value }])
    }

    #[test]
    fn fields_of_tables_and_lists_change_and_only_in_the_file_of_their_flag() {
        let text = || "a = 1\nlist = [{ b = 2 }, { b = 3 }]\n".to_owned();
        let changed = |changes: Changes| changes.over("radio", text()).expect("it can be changed");
        assert!(changed(change("a", "7")).contains("a = 7"));
        let second = changed(change("list.1.b", "9"));
        assert!(second.contains("b = 2") && second.contains("b = 9") && !second.contains("b = 3"), "{second}");
        assert!(changed(change("new.deep", "true")).contains("deep = true"));
        assert_eq!(change("a", "7").over("scenario", text()).expect("nothing changes"), text());
    }

    #[test]
    fn a_path_that_leads_nowhere_is_refused_with_its_name() {
        for (field, says) in [("list.5.b", "'5' is not an index"), ("a.b", "'b' is not a part")] {
            let error = change(field, "1").over("radio", "a = 1\nlist = [1]\n".to_owned()).expect_err(field);
            assert!(error.to_string().starts_with(&format!("radio.{field}: {says}")), "{error}");
        }
    }
}
