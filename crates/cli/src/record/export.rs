//! The command `murmurate record export`: writes tables of a record as CSV.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::record::chosen::print_damage;
use murmurate_record::reader;
use murmurate_record::tables::{self, Table};
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

/// Number of bytes of a table that are written at once.
const PIECE: usize = 1 << 16;

/// File of a table, which appears once it is complete.
struct TableFile {
    table: Table,
    file: WholeFile,
    rows: Vec<u8>,
    count: u64,
    /// First error of writing.
    failure: Option<std::io::Error>,
}

impl TableFile {
    fn open(path: &Path, table: Table) -> Result<TableFile> {
        let rows = format!("{}\n", table.header()).into_bytes();
        Ok(TableFile { table, file: WholeFile::create(path)?, rows, count: 0, failure: None })
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

    fn keep(mut self) -> Result<()> {
        self.flush();
        self.failure.map_or(Ok(()), Err).context("cannot write the table")?;
        self.file.keep()?;
        if self.count == 0 {
            let subject = self.table.subject();
            talk(&format!("warning: the record has no {subject}: the table has its header alone"));
        }
        Ok(())
    }
}

/// Runs `record export`: reads a record and writes the requested CSV tables of trajectories, links and messages.
pub fn run(args: &Args) -> Result<Ended> {
    let named =
        [(&args.trajectories, Table::Trajectories), (&args.links, Table::Links), (&args.messages, Table::Messages)];
    if named.iter().all(|(path, _)| path.is_none()) {
        return bad("name what to export: --trajectories, --links or --messages".to_owned());
    }
    let opened = reader::messages(&args.record).map_err(|error| BadInput(error.to_string()))?;
    let (identity, messages) = opened;
    let whole = print_damage(messages.health(), identity.anchor_ns);
    let files = named.into_iter().filter_map(|(path, table)| Some(TableFile::open(path.as_deref()?, table)));
    let mut files: Vec<TableFile> = files.collect::<Result<_>>()?;
    let wanted: Vec<Table> = files.iter().map(|file| file.table).collect();
    tables::read(&identity, messages, &wanted, |table, row| {
        files.iter_mut().filter(|file| file.table == table).for_each(|file| file.row(row));
    })?;
    files.into_iter().try_for_each(TableFile::keep)?;
    Ok(if whole { Ended::Done } else { Ended::Unfit })
}
