//! Reads whole tables of an SQLite database, as rosbag2's storage `sqlite3` writes them. In Rust alone, and never
//! changes the file.
//!
//! Source: "Database File Format", sqlite.org/fileformat2.html: header (1.3), pages of a table's B-tree (1.6), records
//! (2.1), the schema's table (2.6). What a bag has not is refused: indexes instead of tables, text in UTF-16. Journals
//! are files of their own, and not read here.

use std::collections::BTreeSet;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest row that is read whole \[bytes\].
const LARGEST_ROW: u64 = 64 << 20;
/// Most cells of a row: SQLite's own limit.
const MOST_CELLS: usize = 32_767;
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
    /// Not read: it lies on the further pages of a row of more than 64 MiB.
    Unread,
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
        // Pages still to be read, the next one last, each with its depth. No page belongs to a table twice, and all its
        // rows together are no longer than the file.
        let (mut todo, mut seen) = (vec![(table.root, 0)], BTreeSet::new());
        let mut left = u64::from(self.pages) * self.page_bytes as u64;
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
                left = left.checked_sub(bytes).ok_or(wrong("its rows are longer than the file"))?;
                let payload = self.payload(number, bytes, rest, &mut seen)?;
                let whole = payload.len() as u64 == bytes;
                let cells = record(&payload, whole).ok_or(wrong("a row of it is no record"))?;
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

    /// Returns the `bytes` bytes of a cell, which begins with `rest` on the page `number`, from its further pages, too;
    /// of a cell that is too long, those on this page alone. `seen` has the pages that the table has used.
    fn payload(
        &mut self,
        number: u32,
        bytes: u64,
        rest: &[u8],
        seen: &mut BTreeSet<u32>,
    ) -> Result<Vec<u8>, SqliteError> {
        let wrong = |why| SqliteError::Page(number, why);
        let all = usize::try_from(bytes).map_err(|_| wrong("a row is too long"))?;
        let most = self.usable.checked_sub(35).ok_or(wrong("pages are too small"))?;
        if all <= most {
            return Ok(rest.get(..all).ok_or(wrong("a cell lies outside of it"))?.to_vec());
        }
        // "Cell payload overflow pages" of the format.
        let least = (self.usable - 12) * 32 / 255 - 23;
        let kept = least + (all - least) % (self.usable - 4);
        let here = if kept <= most { kept } else { least };
        let mut payload = rest.get(..here).ok_or(wrong("a cell lies outside of it"))?.to_vec();
        if bytes > LARGEST_ROW {
            return Ok(payload);
        }
        let mut next = u32_at(rest, here).ok_or(wrong("a cell lies outside of it"))?;
        while payload.len() < all {
            if !seen.insert(next) {
                return Err(SqliteError::Page(next, "its pages are a circle"));
            }
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

/// Reads the cells of a row; `None` if they are not as the format says. If `payload` is not the whole row, its last
/// cells are unread.
fn record(payload: &[u8], whole: bool) -> Option<Vec<Value>> {
    let mut head = payload;
    let length = usize::try_from(varint(&mut head)?).ok()?;
    let mut body = payload.get(length..)?;
    let mut head = head.get(..length.checked_sub(payload.len() - head.len())?)?;
    let mut cells = Vec::new();
    while !head.is_empty() {
        if cells.len() == MOST_CELLS {
            return None;
        }
        let kind = varint(&mut head)?;
        let bytes = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            12.. => (kind as usize - 12) / 2,
            _ => return None,
        };
        let Some((value, rest)) = body.split_at_checked(bytes) else {
            if whole {
                return None;
            }
            body = &[];
            cells.push(Value::Unread);
            continue;
        };
        body = rest;
        let number = || {
            value.iter().fold(if *value.first().unwrap_or(&0) >= 0x80 { -1 } else { 0 }, |number: i64, byte| {
                number << 8 | i64::from(*byte)
            })
        };
        cells.push(match kind {
            0 => Value::Null,
            1..=6 => Value::Integer(number()),
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
        assert_eq!(record(&payload, true), Some(cells.to_vec()));
        assert_eq!(record(&payload[..8], true), None);
        assert_eq!(record(&[9, 1], true), None);
        let cut = record(&payload[..12], false).expect("its first cells are there");
        assert_eq!((&cut[..5], &cut[5]), (&cells[..5], &Value::Unread));
    }

    #[test]
    fn columns_are_named_by_the_command_that_made_the_table() {
        let sql = "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL, \"data\" BLOB NOT NULL)";
        assert_eq!(columns(sql), ["id", "topic_id", "data"]);
        assert_eq!(columns("CREATE VIEW"), [""]);
    }

    /// A database of pages of 512 bytes with the table `t (a)`, whose only row has one cell of `bytes` bytes. Its pages
    /// follow each other, from page 3 on.
    fn database(bytes: usize) -> Vec<u8> {
        let leaf = |at: usize, cell: &[u8], page: &mut [u8]| {
            let place = 512 - cell.len();
            page[at] = 0x0d;
            page[at + 3..at + 5].copy_from_slice(&[0, 1]);
            page[at + 8..at + 10].copy_from_slice(&(place as u16).to_be_bytes());
            page[place..].copy_from_slice(cell);
        };
        let mut first = vec![0; 512];
        first[..16].copy_from_slice(b"SQLite format 3\0");
        first[16..18].copy_from_slice(&[2, 0]);
        let sql = b"CREATE TABLE t(a)";
        let head = [6, 23, 15, 15, 1, 13 + 2 * sql.len() as u8];
        let row = [&head[..], b"tablett", &[2], sql].concat();
        leaf(100, &[&[row.len() as u8, 1][..], &row].concat(), &mut first);

        let kind = (bytes * 2 + 12) as u64;
        let varint = |number: u64| [0x80 | (number >> 14 & 0x7f), 0x80 | (number >> 7 & 0x7f), number & 0x7f];
        let row = [&[4][..], &varint(kind).map(|byte| byte as u8), &vec![7; bytes]].concat();
        let (least, most, further) = ((512 - 12) * 32 / 255 - 23, 512 - 35, 512 - 4);
        let kept = least + row.len().saturating_sub(least) % further;
        let here = if row.len() <= most { row.len() } else { Some(kept).filter(|kept| *kept <= most).unwrap_or(least) };
        let mut cell = [&varint(row.len() as u64).map(|byte| byte as u8)[..], &[1], &row[..here]].concat();
        let pieces: Vec<&[u8]> = row[here..].chunks(further).collect();
        if !pieces.is_empty() {
            cell.extend([0, 0, 0, 3]);
        }
        let mut second = vec![0; 512];
        leaf(0, &cell, &mut second);
        let mut file = [first, second].concat();
        for (piece, number) in pieces.iter().zip(4u32..) {
            let next = if number as usize == 3 + pieces.len() { 0 } else { number };
            let mut page = [&next.to_be_bytes()[..], piece].concat();
            page.resize(512, 0);
            file.extend(page);
        }
        file
    }

    /// Rows of the table `t`.
    fn rows(file: Vec<u8>) -> Result<Vec<Vec<Value>>, SqliteError> {
        let mut database = Database::open(io::Cursor::new(file))?;
        let table = database.table("t")?.expect("it is there");
        let mut found = Vec::new();
        database.rows(&table, &mut |_, cells| {
            found.push(cells);
            true
        })?;
        Ok(found)
    }

    #[test]
    fn rows_longer_than_a_page_are_read_whole() {
        for bytes in [0, 10, 400, 473, 474, 500, 600, 981, 1000, 5000, 200_000] {
            assert_eq!(rows(database(bytes)).expect("it is sound"), [[Value::Bytes(vec![7; bytes])]], "{bytes}");
        }
    }

    #[test]
    fn further_pages_in_a_circle_and_rows_longer_than_the_file_are_refused() {
        let mut circle = database(5000);
        circle[5 * 512..5 * 512 + 4].copy_from_slice(&[0, 0, 0, 4]);
        let why = rows(circle).expect_err("a circle").to_string();
        assert!(why.contains("circle"), "{why}");
        // Two cells that are one: each would be read from the same pages.
        let mut twice = database(5000);
        twice[512 + 4] = 2;
        twice.copy_within(512 + 8..512 + 10, 512 + 10);
        assert!(rows(twice).is_err());
        let short = database(5000)[..4 * 512].to_vec();
        let why = rows(short).expect_err("short").to_string();
        assert!(why.contains("longer than the file"), "{why}");
    }

    #[test]
    fn a_row_has_no_more_cells_than_sqlite_allows() {
        let row = |cells: usize| {
            let length = cells as u64 + 3;
            let head = [0x80 | (length >> 14) as u8, 0x80 | (length >> 7 & 0x7f) as u8, (length & 0x7f) as u8];
            [&head[..], &vec![0; cells]].concat()
        };
        assert_eq!(record(&row(MOST_CELLS), true).map(|cells| cells.len()), Some(MOST_CELLS));
        assert_eq!(record(&row(MOST_CELLS + 1), true), None);
    }
}
