//! Tables of a record as rows of CSV: true states of simulated robots, links, messages, and Wi-Fi cards.

use serde_json::Value as Json;

use super::identity::Identity;
use super::reader::{Message, Messages, ReadError};
use super::tape;
use super::topics::{WIFI as WIFI_TOPIC, name_of};
use super::truth::{self, TrueRobot};
use murmurate::graph::inputs::Input;
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::codec::{self, Content, DecodeError};

/// Table of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// True states of simulated robots, over time.
    Trajectories,
    /// Measurements of each other host by a host, once a second.
    Links,
    /// Each datagram that was published, and in a host's record each that arrived.
    Messages,
    /// The stations that the host's Wi-Fi cards hear, once a second, with the load of the channel.
    Wifi,
}

impl Table {
    /// Returns the names of the table's columns.
    pub fn header(self) -> &'static [&'static str] {
        match self {
            Table::Trajectories => TRAJECTORIES,
            Table::Links => LINKS,
            Table::Messages => MESSAGES,
            Table::Wifi => WIFI,
        }
    }

    /// Returns the subject of the table's rows, such as `links`.
    pub fn subject(self) -> &'static str {
        match self {
            Table::Trajectories => "true states",
            Table::Links => "links",
            Table::Messages => "messages",
            Table::Wifi => "Wi-Fi cards",
        }
    }
}

const TRAJECTORIES: &[&str] = &[
    "episode",
    "phase",
    "time_s",
    "robot",
    "x_m",
    "y_m",
    "vx_m_s",
    "vy_m_s",
    "heading_rad",
    "yaw_rate_rad_s",
    "command_x_m_s",
    "command_y_m_s",
    "touches_robot",
    "touches_wall",
];
const LINKS: &[&str] = &[
    "time_s",
    "host",
    "link",
    "peer",
    "incarnation",
    "accepted",
    "age_s",
    "loss",
    "passed",
    "missing",
    "round_trip_s",
    "uncertainty_s",
];
const MESSAGES: &[&str] = &["time_s", "event", "host", "link", "sender", "incarnation", "sequence", "kind", "bytes"];
const WIFI: &[&str] = &[
    "time_s",
    "interface",
    "mode",
    "frequency_mhz",
    "power_save",
    "active_ms",
    "busy_ms",
    "peer",
    "signal_dbm",
    "sent",
    "retries",
    "failed",
    "rate_mbit_s",
    "silent_ms",
];

/// Function that is called with the cells of each row of a table.
type Rows<'a> = dyn FnMut(&[String]) + 'a;

/// Reads the messages of a record, and calls `take` with each row of the tables `wanted`, in the order of time.
pub fn read(
    identity: &Identity,
    mut messages: Messages,
    wanted: &[Table],
    mut take: impl FnMut(Table, &[String]),
) -> Result<(), ReadError> {
    let host = identity.host.as_ref().map_or("", |host| &host.name);
    let (mut phase, mut gaps) = (Some((Json::Null, String::new())), 0);
    while let Some(message) = messages.next_message()? {
        if std::mem::replace(&mut gaps, messages.gaps()) != messages.gaps() {
            // The phase may have changed in what is lost.
            phase = None;
        }
        let at_s = message.at.saturating_sub(identity.anchor_ns) as f64 / 1e9;
        let mut rows_of = |table: Table, fill: &dyn Fn(&mut Rows)| {
            if wanted.contains(&table) {
                fill(&mut |row| take(table, row));
            }
        };
        match &*message.channel.topic {
            "/episode" => {
                let said: Json = serde_json::from_slice(&message.data).unwrap_or_default();
                if let Some(begins) = said["phase"].as_str() {
                    phase = Some((said["episode"].clone(), begins.to_owned()));
                }
            }
            "/truth" => rows_of(Table::Trajectories, &|row| truth(row, at_s, phase.as_ref(), &message.data)),
            "/links" => rows_of(Table::Links, &|row| peers(row, at_s, &message.data)),
            WIFI_TOPIC => rows_of(Table::Wifi, &|row| stations(row, at_s, &message.data)),
            "/tape/turn" => {
                if phase.is_none() {
                    let frames = tape::read(&message.data).into_iter().flat_map(|turn| turn.frames());
                    phase = frames.filter_map(|frame| followed(codec::untagged(&frame))).next();
                }
                rows_of(Table::Messages, &|row| arrived(row, at_s, host, &message.data));
            }
            topic if topic.starts_with("/wire/") => {
                phase = phase.or_else(|| followed(&message.data));
                rows_of(Table::Messages, &|row| published(row, at_s, &message));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Returns episode and phase that the instruction in a datagram gives; `None` for another datagram.
fn followed(datagram: &[u8]) -> Option<(Json, String)> {
    let (kind, body, _) = codec::messages(datagram).next()?;
    let Wire::Mode(mode) = codec::message(kind, body).ok()? else { return None };
    Some((mode.round.episode.into(), name_of(mode.phase).to_owned()))
}

fn truth(row: &mut Rows, at_s: f64, phase: Option<&(Json, String)>, data: &[u8]) {
    let (episode, phase) = phase.map_or((&Json::Null, ""), |(episode, phase)| (episode, &**phase));
    let episode = episode.as_u64().map_or(String::new(), |episode| episode.to_string());
    for of in truth::robots(data) {
        let TrueRobot { robot, x, y, velocity_x, velocity_y, heading, yaw_rate, command_x, command_y, .. } = of;
        let state = [x, y, velocity_x, velocity_y, heading, yaw_rate, command_x, command_y];
        let mut cells = vec![episode.clone(), phase.to_owned(), at_s.to_string(), robot.to_string()];
        cells.extend(state.map(|number| number.to_string()));
        cells.extend([of.touches_robot, of.touches_wall].map(|touches| u8::from(touches).to_string()));
        row(&cells);
    }
}

fn peers(row: &mut Rows, at_s: f64, data: &[u8]) {
    let said: Json = serde_json::from_slice(data).unwrap_or_default();
    let host = said["host"].as_str().unwrap_or_default();
    for peer in said["peers"].as_array().into_iter().flatten() {
        const FIELDS: [&str; 10] =
            ["link", "host", "epoch", "proven", "age_s", "loss", "passed", "missing", "round_trip_s", "uncertainty_s"];
        let cells = FIELDS.iter().map(|field| cell(&peer[*field]));
        row(&[at_s.to_string(), host.to_owned()].into_iter().chain(cells).collect::<Vec<_>>());
    }
}

/// Adds a row for each station that a card hears, or one without a station.
fn stations(row: &mut Rows, at_s: f64, data: &[u8]) {
    let said: Json = serde_json::from_slice(data).unwrap_or_default();
    let card = WIFI[1..7].iter().map(|field| cell(&said[*field]));
    let card: Vec<String> = [at_s.to_string()].into_iter().chain(card).collect();
    let peers = said["peers"].as_array().map_or(&[][..], Vec::as_slice);
    for peer in if peers.is_empty() { &[Json::Null] } else { peers } {
        let fields = ["address"].iter().chain(&WIFI[8..]);
        row(&card.iter().cloned().chain(fields.map(|field| cell(&peer[*field]))).collect::<Vec<_>>());
    }
}

/// Returns the text of a value in a cell; nothing for none.
fn cell(value: &Json) -> String {
    match value {
        Json::Null => String::new(),
        Json::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn published(row: &mut Rows, at_s: f64, message: &Message) {
    let host = message.channel.topic.trim_start_matches("/wire/");
    datagram(row, [at_s.to_string(), "published".to_owned(), host.to_owned(), String::new()], &message.data);
}

fn arrived(row: &mut Rows, at_s: f64, host: &str, data: &[u8]) {
    for input in tape::read(data).into_iter().flat_map(|turn| turn.inputs) {
        if let Input::Frame(link, frame, _) = input {
            let start = [at_s.to_string(), "arrived".to_owned(), host.to_owned(), link.0.to_string()];
            datagram(row, start, &frame);
        }
    }
}

/// Adds the row of a datagram, whose first cells are `start`.
fn datagram(row: &mut Rows, start: [String; 4], frame: &[u8]) {
    let kind = match codec::first(frame) {
        Ok(Content::Message(kind)) => format!("{kind:?}"),
        Ok(_) => "link layer".to_owned(),
        Err(DecodeError::Encrypted) => "encrypted".to_owned(),
        Err(_) => "junk".to_owned(),
    };
    let header = codec::peek(frame).map(|header| {
        let incarnation = format!("{:08x}", header.incarnation);
        [header.sender.0.to_string(), incarnation, header.sequence.to_string(), kind]
    });
    let [empty, junk] = ["", "junk"].map(str::to_owned);
    let header = header.unwrap_or([empty.clone(), empty.clone(), empty, junk]);
    row(&start.into_iter().chain(header).chain([frame.len().to_string()]).collect::<Vec<_>>());
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    #[test]
    fn a_row_has_as_many_cells_as_its_table_has_columns() {
        let mut rows = Vec::new();
        let mut row = |cells: &[String]| rows.push(cells.join(","));
        let robot = TrueRobot { robot: 3, x: 0.5, ..TrueRobot::default() };
        let data = truth::Truth { timestamp: None, robots: vec![robot] }.encode_to_vec();
        let phase = (Json::from(4), "running".to_owned());
        super::truth(&mut row, 1.5, Some(&phase), &data);
        peers(&mut row, 2.0, br#"{"host": "a", "peers": [{"link": 0, "host": 1, "loss": 0.25}]}"#);
        datagram(&mut row, ["2", "arrived", "a", "0"].map(str::to_owned), b"x");
        stations(&mut row, 3.0, br#"{"interface": "wlan0", "mode": "IBSS", "busy_ms": 5, "peers": []}"#);
        stations(&mut row, 3.0, br#"{"interface": "wlan0", "peers": [{"address": "02:00", "signal_dbm": -52}]}"#);
        assert!(rows[0].starts_with("4,running,1.5,3,0.5,0,"), "{}", rows[0]);
        assert_eq!(rows[1], "2,a,0,1,,,,0.25,,,,");
        assert_eq!(rows[2], "2,arrived,a,0,,,,junk,1");
        assert_eq!(rows[3], "3,wlan0,IBSS,,,,5,,,,,,,");
        assert_eq!(rows[4], "3,wlan0,,,,,,02:00,-52,,,,,");
        let tables = [Table::Trajectories, Table::Links, Table::Messages, Table::Wifi, Table::Wifi];
        assert_eq!(rows.len(), tables.len());
        for (row, table) in rows.iter().zip(tables) {
            assert_eq!(row.split(',').count(), table.header().len(), "{row}");
        }
    }
}
