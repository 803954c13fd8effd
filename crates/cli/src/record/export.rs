//! The command `murmurate record export`: writes tables of a record as CSV.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use csv::IntoInnerError;

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
    /// CSV file for the host's Wi-Fi cards: load of the channel and the stations that each hears, once a second
    #[arg(long, value_name = "FILE.csv")]
    wifi: Option<PathBuf>,
}

/// Number of bytes of a table that are written at once.
const PIECE: usize = 1 << 16;

/// File of a table, which appears once it is complete.
struct TableFile {
    table: Table,
    rows: csv::Writer<WholeFile>,
    count: u64,
    /// First error of writing.
    failure: Option<csv::Error>,
}

impl TableFile {
    fn open(path: &Path, table: Table) -> Result<TableFile> {
        let rows = csv::WriterBuilder::new().buffer_capacity(PIECE).from_writer(WholeFile::create(path)?);
        let mut file = TableFile { table, rows, count: 0, failure: None };
        file.write(table.header());
        Ok(file)
    }

    fn write<T: AsRef<[u8]>>(&mut self, row: &[T]) {
        if self.failure.is_none() {
            self.failure = self.rows.write_record(row).err();
        }
    }

    fn keep(self) -> Result<()> {
        self.failure.map_or(Ok(()), Err).context("cannot write the table")?;
        let file = self.rows.into_inner().map_err(IntoInnerError::into_error).context("cannot write the table")?;
        file.keep()?;
        if self.count == 0 {
            let subject = self.table.subject();
            talk(&format!("warning: the record has no {subject}: the table has its header alone"));
        }
        Ok(())
    }
}

/// Runs `record export`: reads a record and writes the requested CSV tables.
pub fn run(args: &Args) -> Result<Ended> {
    let named = [
        (&args.trajectories, Table::Trajectories),
        (&args.links, Table::Links),
        (&args.messages, Table::Messages),
        (&args.wifi, Table::Wifi),
    ];
    if named.iter().all(|(path, _)| path.is_none()) {
        return bad("name what to export: --trajectories, --links, --messages or --wifi".to_owned());
    }
    let opened = reader::messages(&args.record).map_err(|error| BadInput(error.to_string()))?;
    let (identity, messages) = opened;
    let whole = print_damage(messages.health(), identity.anchor_ns);
    let files = named.into_iter().filter_map(|(path, table)| Some(TableFile::open(path.as_deref()?, table)));
    let mut files: Vec<TableFile> = files.collect::<Result<_>>()?;
    let wanted: Vec<Table> = files.iter().map(|file| file.table).collect();
    tables::read(&identity, messages, &wanted, |table, row| {
        files.iter_mut().filter(|file| file.table == table).for_each(|file| {
            file.count += 1;
            file.write(row);
        });
    })?;
    files.into_iter().try_for_each(TableFile::keep)?;
    Ok(if whole { Ended::Done } else { Ended::Unfit })
}
