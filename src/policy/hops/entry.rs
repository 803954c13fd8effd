//! Entries of the observation of a policy of format 2: fields by their names, and channels of the robot as tables.

use std::fmt;

use serde::de::value::{MapAccessDeserializer, StrDeserializer};
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

use crate::messages::geometry::Planar;
use crate::observation::{Observation, Observed, Request};
use crate::policy::manifest::Field;

/// Entry of the observation of a policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Entry {
    /// Field of the robot's state: two floats.
    Field(Field),
    /// Channel or sense of the robot: an array.
    Channel(Named),
}

/// Channel or sense of the robot in a policy's observation, with the name of the entry.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Named {
    /// Name of the entry, by which errors and descriptions call it.
    pub name: String,
    /// Channel, and how the policy takes it.
    #[serde(flatten)]
    pub observed: Observed,
}

impl Entry {
    /// Returns the number of floats of the entry; zero for a channel whose shape is none.
    #[inline]
    pub fn floats(&self) -> usize {
        match self {
            Entry::Field(_) => 2,
            Entry::Channel(Named { observed, .. }) => observed.floats().unwrap_or(0),
        }
    }

    /// Returns the field; `None` for a channel.
    pub fn field(&self) -> Option<Field> {
        match self {
            Entry::Field(field) => Some(*field),
            Entry::Channel(_) => None,
        }
    }

    /// Returns the request for the entry's channel; `None` for a field.
    pub fn request(&self) -> Option<Request> {
        match self {
            Entry::Field(_) => None,
            Entry::Channel(Named { name, observed }) => Some(observed.request(name)),
        }
    }
}

/// Returns the number of floats of all entries.
pub fn floats(entries: &[Entry]) -> usize {
    entries.iter().map(Entry::floats).sum()
}

/// Returns the requests for the channels among the entries, in their order.
pub fn requests(entries: &[Entry]) -> Vec<Request> {
    entries.iter().filter_map(Entry::request).collect()
}

/// Writes the entries one after the other into `to`, which has their [`floats`]. `own.values` has the values of the
/// entries' channels, by their [`requests`].
#[inline]
pub fn write(entries: &[Entry], own: &Observation, to: &mut [f32]) {
    let (mut values, mut rest) = (own.values, to);
    for entry in entries {
        match entry {
            Entry::Field(field) => {
                let (to, after) = rest.split_first_chunk_mut().expect("there is room for each entry");
                *to = field.of(own).to_array();
                rest = after;
            }
            Entry::Channel(_) => {
                let (to, after) = rest.split_at_mut(entry.floats());
                let (now, later) = values.split_at(to.len());
                to.copy_from_slice(now);
                (values, rest) = (later, after);
            }
        }
    }
}

/// Appends the entries to `to`, as [`write()`] writes them.
pub fn append(entries: &[Entry], own: &Observation, to: &mut Vec<f32>) {
    let at = to.len();
    to.resize(at + floats(entries), 0.0);
    write(entries, own, &mut to[at..]);
}

/// Says why a step counts as none: which of the entries' channels have a value that is not known.
pub(crate) fn unknown(entries: &[Entry], values: &[f32]) -> String {
    let (mut rest, mut unknown) = (values, Vec::new());
    for entry in entries {
        let Entry::Channel(Named { name, observed }) = entry else { continue };
        let (now, later) = rest.split_at(entry.floats());
        if !now.iter().all(|value| value.is_finite()) {
            let age = observed.stale_after_s.map(|limit_s| format!(" (no younger than stale_after_s = {limit_s})"));
            unknown.push(format!("'{name}'{}", age.unwrap_or_default()));
        }
        rest = later;
    }
    format!("its observation has no values of {}, or they need a heading that is not known", unknown.join(", "))
}

/// Checks the entries. The error names the first wrong one by its place in the list `observation`.
pub(super) fn check(entries: &[Entry]) -> Result<(), String> {
    let mut names: Vec<&str> = Vec::new();
    for (at, entry) in entries.iter().enumerate() {
        let Entry::Channel(Named { name, observed }) = entry else { continue };
        if name.is_empty() || names.contains(&&**name) {
            return Err(format!("observation.{at}.name: it is empty, or another entry has it"));
        }
        observed.floats().map_err(|why| format!("observation.{at}.shape: {why}"))?;
        names.push(name);
    }
    Ok(())
}

impl From<Field> for Entry {
    fn from(field: Field) -> Entry {
        Entry::Field(field)
    }
}

/// Reads an entry: a text is the name of a field, and a table is a channel.
struct EntryVisitor;

impl<'de> Visitor<'de> for EntryVisitor {
    type Value = Entry;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a field, or a table of a channel")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Entry, E> {
        Field::deserialize(StrDeserializer::new(name)).map(Entry::Field)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Entry, A::Error> {
        let mut fields: Map<String, Value> = Map::deserialize(MapAccessDeserializer::new(map))?;
        let Some(Value::String(name)) = fields.remove("name") else { return Err(A::Error::missing_field("name")) };
        let observed = Observed::deserialize(Value::Object(fields)).map_err(A::Error::custom)?;
        Ok(Entry::Channel(Named { name, observed }))
    }
}

impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Entry, D::Error> {
        deserializer.deserialize_any(EntryVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::{Motion, Vec2};
    use crate::observation::{Frame, Unit};

    const SOME: &str = r#"["position", {"name": "whiskers", "source": "lidar", "shape": [2, 2], "unit": "m",
        "frame": "body", "range_m": 2.5, "miss": "range", "stale_after_s": 0.12, "if_stale": "miss"}, "velocity"]"#;

    #[test]
    fn entries_are_read_from_names_and_tables_and_written_again() {
        let entries: Vec<Entry> = serde_json::from_str(SOME).expect("they are entries");
        let text = serde_json::to_string(&entries).expect("they are data");
        assert_eq!(serde_json::from_str::<Vec<Entry>>(&text).expect("it was written"), entries);
        let packed = rmp_serde::to_vec_named(&entries).expect("they are data");
        assert_eq!(rmp_serde::from_slice::<Vec<Entry>>(&packed).expect("it was written"), entries);
        let [request] = &requests(&entries)[..] else { panic!("one is a channel") };
        assert_eq!((&*request.input, &*request.channel, request.unit), ("whiskers", "lidar", Unit::Metre));
        assert_eq!((request.frame, request.taking.range_m), (Some(Frame::Body), Some(2.5)));
        assert_eq!(floats(&entries), 8);
    }

    #[test]
    fn an_observation_is_its_entries_in_their_order() {
        let entries: Vec<Entry> = serde_json::from_str(SOME).expect("they are entries");
        let motion = Motion { position: Vec2::new(1.0, 2.0), velocity: Vec2::new(3.0, 4.0) };
        let own = Observation { values: &[5.0, 6.0, 7.0, 8.0], ..Observation::new(motion, Vec2::zeros()) };
        let mut found = [0.0; 8];
        write(&entries, &own, &mut found);
        assert_eq!(found, [1.0, 2.0, 5.0, 6.0, 7.0, 8.0, 3.0, 4.0]);
    }

    #[test]
    fn wrong_entries_are_refused_with_their_place() {
        let read = |text: &str| serde_json::from_str::<Vec<Entry>>(text).map_err(|error| error.to_string());
        assert!(read(r#"["place"]"#).is_err_and(|why| why.contains("unknown variant `place`")));
        assert!(read(r#"[{"shape": [2], "unit": "m"}]"#).is_err_and(|why| why.contains("missing field `name`")));
        let unknown = r#"[{"name": "x", "shape": [2], "unit": "m", "sense": "x"}]"#;
        assert!(read(unknown).is_err_and(|why| why.contains("unknown field `sense`")));
        let one = |shape: &str| format!(r#"{{"name": "x", "shape": {shape}, "unit": "m"}}"#);
        let checked = |text: String| check(&read(&text).expect("they are entries")).expect_err("it is wrong");
        assert!(checked(format!("[{}]", one("[0]"))).starts_with("observation.0.shape"));
        assert!(checked(format!("[\"position\", {0}, {0}]", one("[2]"))).starts_with("observation.2.name"));
    }
}
