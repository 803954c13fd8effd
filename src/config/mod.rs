//! Parsing of configurations: TOML and JSON, with errors of one line that name the wrong line or field.
//!
//! A user may pass the file of a team key (the team's secret) by mistake, so no error quotes a value of the text.

pub mod fields;
pub mod kinds;
pub(crate) mod objects;
pub mod regular;
pub mod shown;

use std::borrow::Cow;

use serde::de::DeserializeOwned;
use serde_path_to_error::Segment;

/// Error of a configuration text that cannot be used.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The text is not TOML, or a field is missing, unknown or of the wrong type; the text in the error describes the
    /// fault.
    #[error("{0}")]
    Syntax(String),
    /// The value of a field is invalid.
    #[error("{field}: {reason}")]
    Field {
        /// Path of the wrong field, with dots between the names of nested tables.
        field: String,
        /// Description of the fault, with the permitted values.
        reason: String,
    },
}

impl ConfigError {
    /// Makes the error of an invalid field. `field` is the path of the field, and `reason` describes the fault.
    pub fn field(field: impl Into<String>, reason: impl Into<String>) -> ConfigError {
        ConfigError::Field { field: field.into(), reason: reason.into() }
    }

    /// Returns the error with `table` and a dot before the path of the field, for a field of a nested table. A syntax
    /// error is returned unchanged.
    pub fn within(self, table: &str) -> ConfigError {
        match self {
            ConfigError::Field { field, reason } => ConfigError::field(format!("{table}.{field}"), reason),
            syntax => syntax,
        }
    }
}

/// Number of hexadecimal digits of a team key, the secret with which a team authenticates its messages.
pub(crate) const KEY_DIGITS: usize = 64;
/// Longest run of hexadecimal digits that a message may show: a digest of 128 bits. A key is twice as long.
const SHOWN_DIGITS: usize = 32;
/// Longest name of an unknown field that an error repeats \[characters\].
const SHOWN_NAME: usize = 32;

/// Checks the `value` of a field against the smallest and the largest that there may be, which are both allowed; NaN is
/// refused. The error names the field.
pub fn in_range<T: PartialOrd + std::fmt::Display>(
    field: &str,
    value: T,
    (least, most): (T, T),
) -> Result<(), ConfigError> {
    if (&least..=&most).contains(&&value) {
        return Ok(());
    }
    Err(ConfigError::field(field, format!("{value} is not {least} to {most}")))
}

/// Parses a value of type `T` from a TOML text. The error names line, column and expected type, and quotes no value of
/// the text.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error| syntax(text, &error))
}

/// Converts a TOML table that was already parsed into a value of type `T`. The error names the wrong field by its path
/// and quotes no value of the table.
pub fn from_table<T: DeserializeOwned>(table: &toml::Table) -> Result<T, ConfigError> {
    serde_path_to_error::deserialize(table.clone()).map_err(|error| {
        let message = error.inner().message();
        let why = unquoted(&message.replace('\n', ": "));
        let is_shown = |segment: &Segment| match segment {
            Segment::Map { key } | Segment::Enum { variant: key } => is_name(key),
            Segment::Seq { .. } => true,
            Segment::Unknown => false,
        };
        // The error of a missing field is that of its table, and names the field itself.
        match error.path().iter().len() > 0 && error.path().iter().all(is_shown) {
            true => ConfigError::field(error.path().to_string(), why),
            false => ConfigError::Syntax(why),
        }
    })
}

/// Converts an error of the TOML parser about `text` into a configuration error with line and column. The result quotes
/// no value, since the text may be a secret key by mistake.
pub(crate) fn syntax(text: &str, error: &toml::de::Error) -> ConfigError {
    let why = unquoted(&error.message().replace('\n', ": "));
    let Some(span) = error.span() else { return ConfigError::Syntax(why) };
    let before = &text[..span.start.min(text.len())];
    let field = field_of(text.lines().nth(before.matches('\n').count()).unwrap_or_default());
    let (line, column) =
        (before.matches('\n').count() + 1, before.chars().rev().take_while(|c| *c != '\n').count() + 1);
    ConfigError::Syntax(format!("line {line}, column {column}{field}: {why}"))
}

/// Returns the name of the field or table that a line of TOML begins with, in parentheses for an error. Empty if there
/// is none or if it is long or has unusual characters.
fn field_of(line: &str) -> String {
    let table = line.trim().strip_prefix('[').map(|rest| rest.trim_matches(['[', ']']));
    let name = line.split_once('=').map(|(name, _)| name.trim()).or(table);
    name.filter(|name| is_name(name)).map_or_else(String::new, |name| format!(" ({name})"))
}

/// Whether an error may repeat `name` as that of a field: it is short and has no unusual characters.
fn is_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    !name.is_empty() && name.len() <= SHOWN_NAME && name.chars().all(plain)
}

/// Converts an error of the JSON parser into a text for the user that quotes no value of the parsed file.
pub fn json(error: &serde_json::Error) -> String {
    unquoted(&error.to_string())
}

/// Returns true if the content of a file is a team key (64 hexadecimal digits) and nothing else but surrounding white
/// space.
pub fn is_key(bytes: &[u8]) -> bool {
    let text = bytes.trim_ascii();
    text.len() == KEY_DIGITS && text.iter().all(u8::is_ascii_hexdigit)
}

/// Returns `text` with every run of more than 32 hexadecimal digits replaced by "(hidden)", so that no secret key is
/// printed.
pub fn redacted(text: &str) -> Cow<'_, str> {
    let is_digit = |c: char| c.is_ascii_hexdigit();
    if !text.split(|c| !is_digit(c)).any(|run| run.len() > SHOWN_DIGITS) {
        return Cow::Borrowed(text);
    }
    let (mut shown, mut rest) = (String::new(), text);
    while let Some(start) = rest.find(is_digit) {
        let (before, run) = rest.split_at(start);
        let (run, after) = run.split_at(run.find(|c| !is_digit(c)).unwrap_or(run.len()));
        shown += before;
        shown += if run.len() > SHOWN_DIGITS { "(hidden)" } else { run };
        rest = after;
    }
    shown += rest;
    Cow::Owned(shown)
}

/// Returns the error message of a TOML or JSON parser without the values that it quotes from the parsed text. Short
/// names of unknown fields, and what the parser quotes of its own, stay.
pub fn unquoted(message: &str) -> String {
    let (mut kept, mut rest) = (String::new(), message);
    while let Some(at) = rest.find(['"', '`']) {
        let (before, quoted) = rest.split_at(at);
        let mark = &quoted[..1];
        let Some(end) = closing(&quoted[1..], mark) else {
            // A quotation without an end is taken as a value up to the end.
            return redacted((kept + before).trim_end()).into_owned();
        };
        let (inside, after) = (&quoted[1..=end], &quoted[end + 2..]);
        let own = mark == "`" && !REPEATS.iter().any(|word| before.ends_with(word));
        let name = before.ends_with(UNKNOWN_FIELD) && inside.len() <= SHOWN_NAME;
        if own || name && mark == "`" {
            kept += &format!("{before}{mark}{inside}{mark}");
        } else {
            kept += before.trim_end();
        }
        rest = after;
    }
    redacted(&(kept + rest)).into_owned()
}

/// Words in error messages of serde after which a value of the parsed text follows in backticks.
const REPEATS: [&str; 6] = [UNKNOWN_FIELD, "unknown variant ", "integer ", "floating point ", "boolean ", "character "];
const UNKNOWN_FIELD: &str = "unknown field ";

/// Returns the byte index of the first quotation mark `mark` in `text`; `None` without one. A mark after a backslash
/// is part of the quotation.
fn closing(text: &str, mark: &str) -> Option<usize> {
    let mut escaped = false;
    text.char_indices().find_map(|(at, c)| {
        let ends = !escaped && mark.starts_with(c);
        escaped = c == '\\' && !escaped;
        ends.then_some(at)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    use serde::Deserialize;

    const KEY: &str = "0f1e2d3c4b5a69788796a5b4c3d2e1f00f1e2d3c4b5a69788796a5b4c3d2e1f0";

    #[test]
    fn an_error_shows_line_column_and_expected_type() {
        let error = from_toml::<BTreeMap<String, u32>>("robots = 5\nhosts = \"five\"\n").unwrap_err().to_string();
        assert_eq!(error, "line 2, column 9 (hosts): invalid type: string, expected u32");
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)] // Only the errors of its parser are tested.
    struct Table {
        robots: u32,
        kind: Option<Kind>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Kind {
        AdHoc,
    }

    #[test]
    fn an_error_of_a_table_names_the_field() {
        let error = |text: &str| from_table::<Table>(&text.parse().unwrap()).unwrap_err();
        let wrong = ConfigError::field("kind", "unknown variant, expected `ad-hoc`");
        assert_eq!(error("robots = 5\nkind = \"ad-hok\""), wrong);
        assert!(matches!(error("robots = \"5\""), ConfigError::Field { field, .. } if field == "robots"));
        assert!(matches!(error("robots = 5\nsize = 1"), ConfigError::Field { field, .. } if field == "size"));
        assert_eq!(error("kind = \"ad-hoc\""), ConfigError::Syntax("missing field `robots`".to_owned()));
        let error = error(&format!("robots = 5\nkind = \"{KEY}\"")).to_string();
        assert!(!error.contains("0f1e2d3c"), "{error}");
    }

    #[test]
    fn no_error_quotes_a_value_of_the_text() {
        let values = [KEY.to_owned(), format!("a \\\" {KEY}"), "short and \u{fc}ber".to_owned()];
        for value in values {
            let texts = [
                value.clone(),
                format!("robots = \"{value}\""),
                format!("robots = 5\nkind = \"{value}\""),
                format!("robots = 5 {value}"),
                format!("robots = \"{value}"),
                format!("\"{value}\" = 5"),
            ];
            for text in texts {
                let toml = from_toml::<Table>(&text).unwrap_err().to_string();
                assert!(toml.starts_with("line ") || toml.contains("missing field"), "{toml}");
                let json = text.replacen(" = ", "\":", 1);
                let json = super::json(&serde_json::from_str::<Table>(&format!("{{\"{json}}}")).unwrap_err());
                for error in [toml, json] {
                    assert!(!error.contains("0f1e2d3c") && !error.contains('\n'), "{text}: {error}");
                }
            }
        }
        let error = from_toml::<Table>("robotz = 5").unwrap_err().to_string();
        assert_eq!(error, "line 1, column 1 (robotz): unknown field `robotz`, expected `robots` or `kind`");
        let error = from_toml::<Table>("robots = 5\nkind = \"ad-hok\"").unwrap_err().to_string();
        assert_eq!(error, "line 2, column 8 (kind): unknown variant, expected `ad-hoc`");
    }

    #[test]
    fn a_key_is_recognised_and_hidden_but_a_digest_is_not() {
        assert!(is_key(format!("{KEY}\n").as_bytes()) && !is_key(&KEY.as_bytes()[1..]) && !is_key(&[0xff; 64]));
        assert_eq!(redacted(&format!("a {KEY}, b 12ab")), "a (hidden), b 12ab");
        assert_eq!(redacted(&KEY[..32]), KEY[..32]);
        assert_eq!(redacted(&KEY.to_uppercase()), "(hidden)");
    }
}
