//! The command `murmurate record export`: writes tables of a record as CSV.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::Value as Json;

use crate::record::chosen::tell;
use murmurate::graph::inputs::Input;
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::codec::{self, Content};
use murmurate_record::protobuf_reader::{Fields, Value};
use murmurate_record::reader::{self, Message};
use murmurate_record::tape;
use murmurate_record::topics::name_of;
use murmurate_robot::output::talk;
use murmurate_robot::whole_file::WholeFile;
use murmurate_robot::{BadInput, Ended, bad};

/// Flags of `murmurate record export`.
#[derive(clap::Args)]
pub struct Args {
    /// The record
    #[arg(value_name = "FILE")]
    record: PathBuf,
    /// CSV file for true states of simulated robots: time, phase, position, velocity, heading, command, contacts
    #[arg(long, value_name = "FILE.csv")]
    trajectories: Option<PathBuf>,
    /// CSV file for links: what a host measured of each other host, once a second
    #[arg(long, value_name = "FILE.csv")]
    links: Option<PathBuf>,
    /// CSV file for messages: each datagram that was published, and in a host's record each that arrived
    #[arg(long, value_name = "FILE.csv")]
    messages: Option<PathBuf>,
}

const TRAJECTORIES: &str = "episode,phase,time_s,robot,x_m,y_m,vx_m_s,vy_m_s,heading_rad,yaw_rate_rad_s,command_x_m_s,\
                            command_y_m_s,touches_robot,touches_wall";
const LINKS: &str = "time_s,host,link,peer,incarnation,accepted,age_s,loss,passed,missing,round_trip_s,uncertainty_s";
const MESSAGES: &str = "time_s,event,host,link,sender,incarnation,sequence,kind,bytes";

/// Number of bytes of a table that are written at once.
const PIECE: usize = 1 << 16;

/// CSV table of `record export`, whose file appears once it is complete.
struct Table {
    file: WholeFile,
    rows: Vec<u8>,
    count: u64,
    /// First error of writing.
    failure: Option<std::io::Error>,
}

impl Table {
    fn open(path: Option<&PathBuf>, header: &str) -> Result<Option<Table>> {
        let Some(path) = path else { return Ok(None) };
        let rows = format!("{header}\n").into_bytes();
        Ok(Some(Table { file: WholeFile::create(path)?, rows, count: 0, failure: None }))
    }

    fn row(&mut self, row: &str) {
        self.count += 1;
        self.rows.extend_from_slice(row.as_bytes());
        self.rows.push(b'\n');
        if self.rows.len() >= PIECE {
            self.flush();
        }
    }

    fn flush(&mut self) {
        if self.failure.is_none() {
            self.failure = self.file.writer().write_all(&self.rows).err();
        }
        self.rows.clear();
    }

    fn keep(mut self, what: &str) -> Result<()> {
        self.flush();
        self.failure.map_or(Ok(()), Err).context("cannot write the table")?;
        self.file.keep()?;
        if self.count == 0 {
            talk(&format!("warning: the record has no {what}: the table has its header alone"));
        }
        Ok(())
    }
}

/// Runs `record export`: reads a record and writes the requested CSV tables of trajectories, links and messages.
pub fn run(args: &Args) -> Result<Ended> {
    if args.trajectories.is_none() && args.links.is_none() && args.messages.is_none() {
        return bad("name what to export: --trajectories, --links or --messages".to_owned());
    }
    let opened = reader::messages(&args.record).map_err(|error| BadInput(error.to_string()))?;
    let (identity, mut messages) = opened;
    let whole = tell(messages.health(), identity.anchor_ns);
    let mut trajectories = Table::open(args.trajectories.as_ref(), TRAJECTORIES)?;
    let mut links = Table::open(args.links.as_ref(), LINKS)?;
    let mut datagrams = Table::open(args.messages.as_ref(), MESSAGES)?;
    let host = identity.host.map_or(String::new(), |host| host.name);
    let (mut phase, mut gaps) = (Some((Json::Null, String::new())), 0);
    while let Some(message) = messages.next_message()? {
        if std::mem::replace(&mut gaps, messages.gaps()) != messages.gaps() {
            // The phase may have changed in what is lost.
            phase = None;
        }
        let at_s = message.at.saturating_sub(identity.anchor_ns) as f64 / 1e9;
        match &*message.channel.topic {
            "/episode" => {
                let said: Json = serde_json::from_slice(&message.data).unwrap_or_default();
                if let Some(begins) = said["phase"].as_str() {
                    phase = Some((said["episode"].clone(), begins.to_owned()));
                }
            }
            "/truth" => trajectories.iter_mut().for_each(|table| truth(table, at_s, phase.as_ref(), &message.data)),
            "/links" => links.iter_mut().for_each(|table| peers(table, at_s, &message.data)),
            "/tape/turn" => {
                if phase.is_none() {
                    let frames = tape::read(&message.data).into_iter().flat_map(|turn| turn.frames());
                    phase = frames.filter_map(|frame| followed(codec::untagged(&frame))).next();
                }
                datagrams.iter_mut().for_each(|table| arrived(table, at_s, &host, &message.data));
            }
            topic if topic.starts_with("/wire/") => {
                phase = phase.or_else(|| followed(&message.data));
                datagrams.iter_mut().for_each(|table| published(table, at_s, &message));
            }
            _ => {}
        }
    }
    for (table, what) in [(trajectories, "true states"), (links, "links"), (datagrams, "messages")] {
        table.map_or(Ok(()), |table| table.keep(what))?;
    }
    Ok(if whole { Ended::Done } else { Ended::Unfit })
}

/// Returns episode and phase that the instruction in a datagram gives; `None` for another datagram.
fn followed(datagram: &[u8]) -> Option<(Json, String)> {
    let (_, Wire::Mode(mode)) = codec::decode(datagram).ok()? else { return None };
    Some((mode.round.episode.into(), name_of(mode.phase).to_owned()))
}

fn truth(table: &mut Table, at_s: f64, phase: Option<&(Json, String)>, data: &[u8]) {
    let (episode, phase) = phase.map_or((&Json::Null, ""), |(episode, phase)| (episode, &**phase));
    for (_, robot) in Fields(data).filter(|(field, _)| *field == 2) {
        let mut fields = [0.0; 12];
        for (field, value) in Fields(robot.bytes().unwrap_or_default()) {
            if let (Some(place), Some(number)) = (fields.get_mut(field as usize), Value::number(value)) {
                *place = number;
            }
        }
        let [_, robot, x, y, vx, vy, heading, yaw_rate, command_x, command_y, robots, walls] = fields;
        let episode = episode.as_u64().map_or(String::new(), |episode| episode.to_string());
        table.row(&format!(
            "{episode},{phase},{at_s},{robot},{x},{y},{vx},{vy},{heading},{yaw_rate},{command_x},{command_y},{robots},\
             {walls}"
        ));
    }
}

fn peers(table: &mut Table, at_s: f64, data: &[u8]) {
    let said: Json = serde_json::from_slice(data).unwrap_or_default();
    let host = said["host"].as_str().unwrap_or_default();
    for peer in said["peers"].as_array().into_iter().flatten() {
        const FIELDS: [&str; 10] =
            ["link", "host", "epoch", "proven", "age_s", "loss", "passed", "missing", "round_trip_s", "uncertainty_s"];
        let text = |value: &Json| if value.is_null() { String::new() } else { value.to_string() };
        let cells: Vec<String> = FIELDS.iter().map(|field| text(&peer[*field])).collect();
        table.row(&format!("{at_s},{host},{}", cells.join(",")));
    }
}

fn published(table: &mut Table, at_s: f64, message: &Message) {
    let host = message.channel.topic.trim_start_matches("/wire/");
    datagram(table, &format!("{at_s},published,{host},"), &message.data);
}

fn arrived(table: &mut Table, at_s: f64, host: &str, data: &[u8]) {
    for input in tape::read(data).into_iter().flat_map(|turn| turn.inputs) {
        if let Input::Frame(link, frame, _) = input {
            datagram(table, &format!("{at_s},arrived,{host},{}", link.0), &frame);
        }
    }
}

fn datagram(table: &mut Table, start: &str, frame: &[u8]) {
    let Ok(header) = codec::peek(frame) else {
        table.row(&format!("{start},,,,junk,{}", frame.len()));
        return;
    };
    let kind = match codec::first(frame) {
        Ok(Content::Message(kind)) => format!("{kind:?}"),
        Ok(_) => "link layer".to_owned(),
        Err(_) => "junk".to_owned(),
    };
    let (sender, incarnation, sequence) = (header.sender.0, header.incarnation, header.sequence);
    table.row(&format!("{start},{sender},{incarnation:08x},{sequence},{kind},{}", frame.len()));
}
