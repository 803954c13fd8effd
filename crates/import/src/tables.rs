//! Reads poses, commands and receipts from CSV files, as a mapping names their columns.

use std::collections::BTreeMap;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

use csv::{Reader, StringRecord};

use murmurate::config::regular;
use murmurate::messages::geometry::rotated;
use murmurate_record::receipt::Receipt;
use murmurate_ros2::sample;

use crate::error::ImportError;
use crate::mapping::{
    Angle, CommandColumns, Episodes, Frame, HeadingColumns, Length, Mapping, PoseColumns, Receipts, TimeUnit, Units,
    of_robot,
};
use crate::samples::{Command, MOST, Pose, Samples};

/// Largest position, velocity or angle in a file, in metres, metres a second and radians.
const LARGEST: f64 = 1e5;
/// First time that is too late to be one \[ns\].
const LATEST: i64 = 1 << 61;

/// A CSV file that is being read.
struct Sheet {
    path: PathBuf,
    rows: Reader<Box<dyn Read>>,
    heads: StringRecord,
}

/// A row of a CSV file, and its line.
struct Row<'a> {
    path: &'a Path,
    line: u64,
    cells: StringRecord,
}

/// Column of a sheet: its name and place.
#[derive(Clone, Debug)]
struct Column {
    name: String,
    at: usize,
}

impl Sheet {
    fn open(path: &Path) -> Result<Sheet, ImportError> {
        let file = regular::open(path).map_err(|error| ImportError::file(path, error))?;
        let mut rows = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(Box::new(file) as Box<dyn Read>);
        let heads = rows.headers().map_err(|error| wrong(path, &error))?.clone();
        Ok(Sheet { path: path.to_owned(), rows, heads })
    }

    /// Returns the column `name`, which the field `field` of the mapping names.
    fn column(&self, field: &str, name: &str) -> Result<Column, ImportError> {
        let mut places = self.heads.iter().zip(0..).filter(|(head, _)| *head == name);
        match (places.next(), places.next()) {
            (Some((_, at)), None) => return Ok(Column { name: name.to_owned(), at }),
            (Some(_), Some(_)) => {
                let why = format!("{field}: two columns have the name '{name}': rename one");
                return Err(ImportError::file(&self.path, why));
            }
            (None, _) => {}
        }
        let heads: Vec<&str> = self.heads.iter().take(40).collect();
        let why = format!("{field}: there is no column '{name}'; there are: {}", heads.join(", "));
        Err(ImportError::file(&self.path, why))
    }

    /// Calls `take` with each row.
    fn rows(&mut self, mut take: impl FnMut(&Row) -> Result<(), ImportError>) -> Result<(), ImportError> {
        let mut row = Row { path: &self.path, line: 0, cells: StringRecord::new() };
        while self.rows.read_record(&mut row.cells).map_err(|error| wrong(&self.path, &error))? {
            row.line = row.cells.position().map_or(0, csv::Position::line);
            take(&row)?;
        }
        Ok(())
    }
}

/// Returns the error of a CSV file as one line with the number of its line.
fn wrong(path: &Path, error: &csv::Error) -> ImportError {
    let line = error.position().map_or(1, csv::Position::line);
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            let why = format!("line {line}: it has {len} cells, and the first line has {expected_len}");
            ImportError::file(path, why)
        }
        csv::ErrorKind::Utf8 { .. } => ImportError::file(path, format!("line {line}: it is no text in UTF-8")),
        csv::ErrorKind::Io(error) => ImportError::file(path, error),
        _ => ImportError::file(path, format!("line {line}: it is no row of CSV")),
    }
}

impl Row<'_> {
    fn cell(&self, column: &Column) -> &str {
        self.cells.get(column.at).unwrap_or("")
    }

    fn wrong(&self, column: &Column, why: &str) -> ImportError {
        ImportError::file(self.path, format!("line {}: column '{}': {why}", self.line, column.name))
    }

    /// Returns the number in a cell times `factor`; `None` if the cell is empty.
    fn number(&self, column: &Column, factor: f64) -> Result<Option<f64>, ImportError> {
        let cell = self.cell(column);
        if cell.is_empty() {
            return Ok(None);
        }
        let number = cell.parse().ok().map(|number: f64| number * factor);
        let sound = number.filter(|number| number.abs() <= LARGEST);
        sound.map(Some).ok_or_else(|| self.wrong(column, "it is no number, or a very large one"))
    }

    /// Returns the number in a cell times `factor`, which has to be there.
    fn some(&self, column: &Column, factor: f64) -> Result<f64, ImportError> {
        self.number(column, factor)?.ok_or_else(|| self.wrong(column, "it is empty"))
    }

    /// Returns the time in a cell \[ns\]; `None` if the cell is empty.
    fn time(&self, column: &Column, unit: TimeUnit) -> Result<Option<i64>, ImportError> {
        let unit_ns = match unit {
            TimeUnit::S => 1_000_000_000,
            TimeUnit::Ms => 1_000_000,
            TimeUnit::Us => 1000,
            TimeUnit::Ns => 1,
        };
        let cell = self.cell(column);
        if cell.is_empty() {
            return Ok(None);
        }
        let whole = cell.parse().ok().and_then(|whole: i64| whole.checked_mul(unit_ns));
        let parts = || cell.parse().ok().map(|parts: f64| (parts * unit_ns as f64).round() as i64);
        let time = whole.or_else(parts).filter(|_| cell.parse::<f64>().is_ok_and(f64::is_finite));
        let sound = time.filter(|time| (-LATEST..LATEST).contains(time));
        sound.map(Some).ok_or_else(|| self.wrong(column, "it is no time"))
    }

    /// Returns the robot that a cell names, by its place in `names`.
    fn robot(&self, column: &Column, names: &[String]) -> Result<usize, ImportError> {
        let cell = self.cell(column);
        let number = |name: &str| name.parse::<u64>().ok();
        let place = names.iter().position(|name| name == cell);
        // 3 and 03, as people number robots.
        let place =
            place.or_else(|| names.iter().position(|name| number(name).is_some_and(|n| Some(n) == number(cell))));
        place.ok_or_else(|| self.wrong(column, "it names no robot of the mapping's 'robots'"))
    }

    /// Returns the robots of which the row tells: the one in `column`, or all without one.
    fn robots(&self, column: Option<&Column>, names: &[String]) -> Result<Range<usize>, ImportError> {
        let Some(column) = column else { return Ok(0..names.len()) };
        let robot = self.robot(column, names)?;
        Ok(robot..robot + 1)
    }
}

fn metres(length: Length) -> f64 {
    match length {
        Length::M => 1.0,
        Length::Cm => 0.01,
        Length::Mm => 0.001,
    }
}

fn radians(angle: Angle) -> f64 {
    match angle {
        Angle::Rad => 1.0,
        Angle::Deg => std::f64::consts::PI / 180.0,
    }
}

/// Returns the column or, if `template` has `{robot}` in it, the columns of all robots.
fn columns(sheet: &Sheet, field: &str, template: &str, names: &[String]) -> Result<Vec<Column>, ImportError> {
    names.iter().map(|name| sheet.column(field, &of_robot(template, name))).collect()
}

/// Columns of the poses of each robot.
struct PosePlaces {
    x: Vec<Column>,
    y: Vec<Column>,
    /// Columns of the yaw, or of the quaternion's x, y, z and w.
    heading: Vec<Vec<Column>>,
    velocity: Vec<Vec<Column>>,
    touches: Vec<Vec<Column>>,
}

impl PosePlaces {
    fn of(sheet: &Sheet, of: &PoseColumns, names: &[String]) -> Result<PosePlaces, ImportError> {
        let each = |field: &str, templates: &[String]| {
            templates.iter().map(|template| columns(sheet, field, template, names)).collect::<Result<Vec<_>, _>>()
        };
        let (field, heading) = match &of.heading {
            None => ("", &[][..]),
            Some(HeadingColumns::Yaw(yaw)) => ("poses.yaw", std::slice::from_ref(yaw)),
            Some(HeadingColumns::Quaternion(all)) => ("poses.quaternion", &all[..]),
        };
        Ok(PosePlaces {
            x: columns(sheet, "poses.x", &of.position[0], names)?,
            y: columns(sheet, "poses.y", &of.position[1], names)?,
            heading: each(field, heading)?,
            velocity: each("poses.velocity", of.velocity.as_ref().map_or(&[][..], |(columns, _)| &columns[..]))?,
            touches: each("poses.touches", &of.touches)?,
        })
    }

    /// Returns the pose of the robot in a row, without its episode; `None` if the robot was not seen.
    fn pose(
        &self,
        row: &Row,
        at_ns: i64,
        robot: usize,
        (of, units): (&PoseColumns, &Units),
    ) -> Result<Option<Pose>, ImportError> {
        let (metre, radian) = (metres(units.length), radians(units.angle));
        let place = [&self.x[robot], &self.y[robot]].map(|column| row.number(column, metre));
        let [x, y] = place;
        let (Some(x), Some(y)) = (x?, y?) else { return Ok(None) };
        let yaw = match &self.heading[..] {
            [] => None,
            [yaw] => row.number(&yaw[robot], radian)?,
            [x, y, z, w] => quaternion(row, [x, y, z, w].map(|columns| &columns[robot]))?,
            _ => unreachable!("a heading has one or four columns"),
        };
        let velocity = match (&self.velocity[..], &of.velocity) {
            ([x, y], Some((_, frame))) => {
                let both = [row.some(&x[robot], metre)?, row.some(&y[robot], metre)?];
                let body = *frame == Frame::Body;
                let Some(turn) = (if body { yaw } else { Some(0.0) }) else { return Ok(None) };
                Some(rotated(turn, both[0], both[1]).into())
            }
            _ => None,
        };
        let mut touches = false;
        for column in &self.touches {
            touches |= row.number(&column[robot], 1.0)?.is_some_and(|number| number != 0.0);
        }
        Ok(Some(Pose { at_ns, position: [x, y], yaw, velocity, touches, label: None }))
    }
}

/// Returns the rotation about the z axis of the quaternion in these columns \[rad\]; `None` if they are empty.
fn quaternion(row: &Row, columns: [&Column; 4]) -> Result<Option<f64>, ImportError> {
    let mut parts = [0.0; 4];
    for (part, column) in parts.iter_mut().zip(columns) {
        let Some(number) = row.number(column, 1.0)? else { return Ok(None) };
        *part = number;
    }
    sample::yaw(parts).map_err(|_| row.wrong(columns[3], "it is of no unit quaternion"))
}

/// Reads the poses of all robots from a table.
pub fn poses(mapping: &Mapping, (of, units): (&PoseColumns, &Units), samples: &mut Samples) -> Result<(), ImportError> {
    let names = &mapping.names;
    let mut sheet = Sheet::open(&mapping.path)?;
    let time = sheet.column("poses.time", &of.time)?;
    let robot = of.robot.as_ref().map(|name| sheet.column("poses.robot", name)).transpose()?;
    let places = PosePlaces::of(&sheet, of, names)?;
    let label = match &mapping.episodes {
        Episodes::Column(name) => Some(sheet.column("episodes", name)?),
        _ => None,
    };
    let mut labels: BTreeMap<String, u32> = BTreeMap::new();
    sheet.rows(|row| {
        let at_ns = row.time(&time, units.time)?.ok_or_else(|| row.wrong(&time, "it is empty"))?;
        let label = label.as_ref().map_or(Some(0), |column| {
            let next = labels.len() as u32;
            let cell = Some(row.cell(column)).filter(|cell| !cell.is_empty())?;
            Some(*labels.entry(cell.to_owned()).or_insert(next))
        });
        for robot in row.robots(robot.as_ref(), names)? {
            let Some(pose) = places.pose(row, at_ns, robot, (of, units))? else { continue };
            counted(row, samples)?;
            samples.poses[robot].push(Pose { label, ..pose });
        }
        Ok(())
    })
}

/// Counts the next sample, which is in this row. Fails if it is one more than are read of a run.
fn counted(row: &Row, samples: &mut Samples) -> Result<(), ImportError> {
    if samples.count() {
        return Ok(());
    }
    Err(ImportError::file(row.path, format!("line {}: the run has more than {MOST} samples: cut it", row.line)))
}

/// Reads the commands of all robots from a table.
pub fn commands(
    (of, units): (&CommandColumns, &Units),
    names: &[String],
    samples: &mut Samples,
) -> Result<(), ImportError> {
    let mut sheet = Sheet::open(&of.path)?;
    let time = sheet.column("commands.time", &of.time)?;
    let robot = of.robot.as_ref().map(|name| sheet.column("commands.robot", name)).transpose()?;
    let x = columns(&sheet, "commands.x", &of.x, names)?;
    let y = of.y.as_ref().map(|name| columns(&sheet, "commands.y", name, names)).transpose()?;
    let metre = metres(units.length);
    sheet.rows(|row| {
        let at_ns = row.time(&time, units.time)?.ok_or_else(|| row.wrong(&time, "it is empty"))?;
        for robot in row.robots(robot.as_ref(), names)? {
            // An empty cell: no command came at that time.
            let Some(along) = row.number(&x[robot], metre)? else { continue };
            let across = y.as_ref().map_or(Ok(Some(0.0)), |y| row.number(&y[robot], metre))?;
            counted(row, samples)?;
            samples.commands[robot].push(Command { at_ns, velocity: [along, across.unwrap_or(0.0)] });
        }
        Ok(())
    })
}

/// Reads the receipts of messages from a table.
pub fn receipts(of: &Receipts, names: &[String], samples: &mut Samples) -> Result<(), ImportError> {
    let mut sheet = Sheet::open(&of.path)?;
    let sent = sheet.column("receipts.sent", &of.sent)?;
    let received = sheet.column("receipts.received", &of.received)?;
    let sender = sheet.column("receipts.sender", &of.sender)?;
    let receiver = sheet.column("receipts.receiver", &of.receiver)?;
    let unit = of.time.unwrap_or_default();
    sheet.rows(|row| {
        let sent_ns = row.time(&sent, unit)?.ok_or_else(|| row.wrong(&sent, "it is empty"))?;
        let received_ns = row.time(&received, unit)?;
        let [from, to] = [row.robot(&sender, names)?, row.robot(&receiver, names)?].map(|robot| robot as u16);
        counted(row, samples)?;
        samples.receipts.push(Receipt { from, to, sent_ns, received_ns });
        Ok(())
    })
}
