//! Reads whole tables of an SQLite database, as rosbag2's storage `sqlite3` writes them. In Rust alone, and never
//! changes the file.
//!
//! Source: "Database File Format", sqlite.org/fileformat2.html: header (1.3), pages of a table's B-tree (1.6), records
//! (2.1), the schema's table (2.6). What a bag has not is refused: indexes instead of tables, text in UTF-16, a journal
//! that was not merged.

use std::collections::BTreeSet;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest row that is read \[bytes\].
const LARGEST_ROW: u64 = 64 << 20;
/// Deepest tree that a table has: SQLite's own limit.
const DEEPEST: usize = 20;

/// Reason why a database cannot be read, with the page where that is known.
#[derive(Debug, thiserror::Error)]
pub enum SqliteError {
    /// The operating system cannot read the file.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// It is no database, or of a kind that is not read.
    #[error("{0}")]
    Kind(&'static str),
    /// A page is not as the format says.
    #[error("page {0} of the database is damaged: {1}")]
    Page(u32, &'static str),
}

/// Value of a cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// No value; that of a column `INTEGER PRIMARY KEY` is the row's number.
    Null,
    /// Whole number.
    Integer(i64),
    /// Float.
    Real(f64),
    /// Text or bytes.
    Bytes(Vec<u8>),
}

impl Value {
    /// Returns the whole number; `None` for another value.
    pub fn integer(&self) -> Option<i64> {
        if let Value::Integer(number) = self { Some(*number) } else { None }
    }

    /// Returns the text; `None` for another value.
    pub fn text(&self) -> Option<&str> {
        if let Value::Bytes(bytes) = self { std::str::from_utf8(bytes).ok() } else { None }
    }
}

/// An open database.
pub struct Database<F> {
    file: F,
    page_bytes: usize,
    /// Bytes of a page that the format uses.
    usable: usize,
    pages: u32,
}

/// A table: the page of its root, and the names of its columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    root: u32,
    /// Names of the columns, in order.
    pub columns: Vec<String>,
}

/// Function that takes the number and the cells of a row, and says whether to go on.
type Take<'a> = &'a mut dyn FnMut(i64, Vec<Value>) -> bool;

impl<F: Read + Seek> Database<F> {
    /// Opens a database and reads its header.
    pub fn open(mut file: F) -> Result<Database<F>, SqliteError> {
        let length = file.seek(SeekFrom::End(0))?;
        file.seek(SeekFrom::Start(0))?;
        let mut head = [0; 100];
        let whole = file.read_exact(&mut head);
        if whole.is_err() || !head.starts_with(b"SQLite format 3\0") {
            return Err(SqliteError::Kind("it is no SQLite database"));
        }
        let page_bytes = match u16::from_be_bytes([head[16], head[17]]) {
            1 => 1 << 16,
            size if size >= 512 && size.is_power_of_two() => usize::from(size),
            _ => return Err(SqliteError::Kind("its header has no size of pages")),
        };
        if head[56..60] != [0, 0, 0, 1] && head[56..60] != [0; 4] {
            return Err(SqliteError::Kind("its text is not UTF-8"));
        }
        let pages = u32::try_from(length.div_ceil(page_bytes as u64)).unwrap_or(u32::MAX);
        Ok(Database { file, page_bytes, usable: page_bytes.saturating_sub(usize::from(head[20])), pages })
    }

    /// Returns the table `name`; `None` if there is none.
    pub fn table(&mut self, name: &str) -> Result<Option<Table>, SqliteError> {
        let schema = Table { root: 1, columns: Vec::new() };
        let mut found = None;
        self.rows(&schema, &mut |_, cells| {
            let [kind, own, _, root, sql] = &cells[..] else { return true };
            if kind.text() == Some("table") && own.text() == Some(name) {
                let root = root.integer().and_then(|root| u32::try_from(root).ok());
                found = root.zip(sql.text().map(columns)).map(|(root, columns)| Table { root, columns });
            }
            found.is_none()
        })?;
        Ok(found)
    }

    /// Calls `take` with each row of a table, in the order of their numbers, until it says no.
    pub fn rows(&mut self, table: &Table, take: Take) -> Result<(), SqliteError> {
        // Pages still to be read, the next one last, each with its depth. No page belongs to a table twice.
        let (mut todo, mut seen) = (vec![(table.root, 0)], BTreeSet::new());
        while let Some((number, depth)) = todo.pop() {
            if depth > DEEPEST || !seen.insert(number) {
                return Err(SqliteError::Page(number, "its pages are a circle"));
            }
            let page = self.page(number)?;
            let at = if number == 1 { 100 } else { 0 };
            let wrong = |why| SqliteError::Page(number, why);
            let (kind, count) = (page[at], usize::from(u16_at(&page, at + 3).ok_or(wrong("it is short"))?));
            let head = match kind {
                0x05 => 12,
                0x0d => 8,
                _ => return Err(wrong("it is no page of a table")),
            };
            let mut children = Vec::new();
            for cell in 0..count {
                let place = u16_at(&page, at + head + 2 * cell).ok_or(wrong("a cell lies outside of it"))?;
                let mut rest = page.get(usize::from(place)..self.usable).ok_or(wrong("a cell lies outside of it"))?;
                if kind == 0x05 {
                    children.push(u32_of(&mut rest).ok_or(wrong("a cell lies outside of it"))?);
                    continue;
                }
                let bytes = varint(&mut rest).ok_or(wrong("a cell lies outside of it"))? as u64;
                let row = varint(&mut rest).ok_or(wrong("a cell lies outside of it"))?;
                let payload = self.payload(number, bytes, rest)?;
                let cells = record(&payload).ok_or(wrong("a row of it is no record"))?;
                if !take(row, cells) {
                    return Ok(());
                }
            }
            if kind == 0x05 {
                children.push(u32_at(&page, at + 8).ok_or(wrong("it is short"))?);
                todo.extend(children.into_iter().rev().map(|child| (child, depth + 1)));
            }
        }
        Ok(())
    }

    fn page(&mut self, number: u32) -> Result<Vec<u8>, SqliteError> {
        if number == 0 || number > self.pages {
            return Err(SqliteError::Page(number, "there is none of this number"));
        }
        let mut page = vec![0; self.page_bytes];
        self.file.seek(SeekFrom::Start(u64::from(number - 1) * self.page_bytes as u64))?;
        self.file.read_exact(&mut page).map_err(|_| SqliteError::Page(number, "the file ends in it"))?;
        Ok(page)
    }

    /// Returns the `bytes` bytes of a cell, which begins with `rest` on the page `number`, from its further pages, too.
    fn payload(&mut self, number: u32, bytes: u64, rest: &[u8]) -> Result<Vec<u8>, SqliteError> {
        let wrong = |why| SqliteError::Page(number, why);
        let all = usize::try_from(bytes).ok().filter(|_| bytes <= LARGEST_ROW).ok_or(wrong("a row is too long"))?;
        let most = self.usable.checked_sub(35).ok_or(wrong("pages are too small"))?;
        if all <= most {
            return Ok(rest.get(..all).ok_or(wrong("a cell lies outside of it"))?.to_vec());
        }
        // "Cell payload overflow pages" of the format.
        let least = (self.usable - 12) * 32 / 255 - 23;
        let kept = least + (all - least) % (self.usable - 4);
        let here = if kept <= most { kept } else { least };
        let mut payload = rest.get(..here).ok_or(wrong("a cell lies outside of it"))?.to_vec();
        let mut next = u32_at(rest, here).ok_or(wrong("a cell lies outside of it"))?;
        while payload.len() < all {
            let page = self.page(next)?;
            let takes = (all - payload.len()).min(self.usable - 4);
            payload.extend(page.get(4..4 + takes).ok_or(wrong("pages are too small"))?);
            next = u32_at(&page, 0).ok_or(wrong("pages are too small"))?;
        }
        Ok(payload)
    }
}

/// Returns the names of the columns of a table, from the command that made it.
fn columns(sql: &str) -> Vec<String> {
    let inner = sql.split_once('(').map_or("", |(_, rest)| rest.rsplit_once(')').map_or("", |(inner, _)| inner));
    let first = |part: &str| part.split_whitespace().next().unwrap_or("").trim_matches(['"', '`', '[', ']']).to_owned();
    inner.split(',').map(first).collect()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn u32_of(rest: &mut &[u8]) -> Option<u32> {
    let number = u32_at(rest, 0)?;
    *rest = &rest[4..];
    Some(number)
}

/// Reads a whole number of 1 to 9 bytes: seven bits of each, but all of the ninth.
fn varint(rest: &mut &[u8]) -> Option<i64> {
    let mut number = 0u64;
    for at in 0..9 {
        let byte = *rest.get(at)?;
        if at == 8 {
            number = number << 8 | u64::from(byte);
        } else {
            number = number << 7 | u64::from(byte & 0x7f);
        }
        if byte < 0x80 || at == 8 {
            *rest = &rest[at + 1..];
            break;
        }
    }
    Some(number as i64)
}

/// Reads the cells of a row; `None` if they are not as the format says.
fn record(payload: &[u8]) -> Option<Vec<Value>> {
    let mut head = payload;
    let length = usize::try_from(varint(&mut head)?).ok()?;
    let mut body = payload.get(length..)?;
    let mut head = head.get(..length.checked_sub(payload.len() - head.len())?)?;
    let mut cells = Vec::new();
    while !head.is_empty() {
        let kind = varint(&mut head)?;
        let bytes = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            12.. => (kind as usize - 12) / 2,
            _ => return None,
        };
        let (value, rest) = body.split_at_checked(bytes)?;
        body = rest;
        let whole = || {
            value.iter().fold(if *value.first().unwrap_or(&0) >= 0x80 { -1 } else { 0 }, |number: i64, byte| {
                number << 8 | i64::from(*byte)
            })
        };
        cells.push(match kind {
            0 => Value::Null,
            1..=6 => Value::Integer(whole()),
            7 => Value::Real(f64::from_be_bytes(value.try_into().ok()?)),
            8 | 9 => Value::Integer(kind - 8),
            _ => Value::Bytes(value.to_vec()),
        });
    }
    Some(cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_all_lengths_and_cells_of_all_kinds_are_read() {
        for (bytes, number) in
            [(&[0x05][..], 5), (&[0x81, 0x00], 128), (&[0xff; 9], -1), (&[0x82, 0x80, 0x01], 2 << 14 | 1)]
        {
            let mut rest = bytes;
            assert_eq!((varint(&mut rest), rest.len()), (Some(number), 0), "{bytes:?}");
        }
        assert_eq!(varint(&mut &[0x81][..]), None);
        let payload = [7, 0, 1, 2, 9, 17, 14, 0xff, 0x01, 0x00, b'o', b'k', 0x07];
        let bytes = |text: &[u8]| Value::Bytes(text.to_vec());
        let cells =
            [Value::Null, Value::Integer(-1), Value::Integer(256), Value::Integer(1), bytes(b"ok"), bytes(&[7])];
        assert_eq!(record(&payload), Some(cells.to_vec()));
        assert_eq!(record(&payload[..8]), None);
        assert_eq!(record(&[9, 1]), None);
    }

    #[test]
    fn columns_are_named_by_the_command_that_made_the_table() {
        let sql = "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL, \"data\" BLOB NOT NULL)";
        assert_eq!(columns(sql), ["id", "topic_id", "data"]);
        assert_eq!(columns("CREATE VIEW"), [""]);
    }
}
