//! Parsing of JSON objects that people write, such as the manifest of a policy file: an error names the wrong field by
//! its path and shows the value, because the text lies within a file and has no lines that one could look up.

use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_path_to_error::{Path, Segment};

use super::redacted;

/// Longest value that an error shows \[characters\]; the rest is replaced by dots.
const SHOWN_VALUE: usize = 60;
/// Number of characters that an error shows of a text that is not JSON, before and after the fault.
const SHOWN_AROUND: usize = 20;
/// Shortest run of hexadecimal digits that may be a part of a key.
const KEY_PART: usize = 12;
/// A text that no field has among its permitted words.
const NO_WORD: &str = "?";

/// Parses the JSON text of an object. An error is one line: the path of the wrong field with dots (`hops.0.heads`), its
/// value, and what is expected.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let whole: Value = serde_json::from_str(text).map_err(|error| not_json(text, &error))?;
    // From the text and not from the parsed value, in which a field that is there twice would be there once.
    let mut reader = serde_json::Deserializer::from_str(text);
    serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = steps(error.path());
        let message = error.inner().to_string();
        // Line and column count in a text that nobody sees.
        let message = message.rsplit_once(" at line ").map_or(&*message, |(before, _)| before);
        described::<T>(&whole, path, message)
    })
}

/// Returns the value of a field as an error shows it: JSON, short, and without a team key.
pub fn shown(value: &Value) -> String {
    let text = redacted(&value.to_string()).into_owned();
    match text.char_indices().nth(SHOWN_VALUE) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}

/// Describes a text that is not JSON, with what stands around the fault.
fn not_json(text: &str, error: &serde_json::Error) -> String {
    let why = super::json(error);
    let why = why.rsplit_once(" at line ").map_or(&*why, |(before, _)| before);
    let before: usize = text.lines().take(error.line().saturating_sub(1)).map(|line| line.len() + 1).sum();
    let at = (before + error.column()).min(text.len());
    let at = (0..=at).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
    let near: String = text[..at].chars().rev().take(SHOWN_AROUND).collect::<Vec<_>>().into_iter().rev().collect();
    let near = near + &text[at..].chars().take(SHOWN_AROUND).collect::<String>();
    let near = near.trim();
    // A part of a key is shorter than what is recognised as one.
    let is_secret = near.split(|c: char| !c.is_ascii_hexdigit()).any(|run| run.len() >= KEY_PART);
    if is_secret {
        return format!("it is not JSON: {why}");
    }
    let near = near.to_owned();
    let hint = ["NaN", "Infinity"].into_iter().find(|word| near.contains(word));
    let hint = hint.map_or(String::new(), |_| "; JSON has no NaN and no infinity".to_owned());
    format!("it is not JSON: {why} near {}{hint}", Value::String(near))
}

/// Returns the parts of a path: names of fields and indices of lists.
fn steps(path: &Path) -> Vec<String> {
    let step = |segment: &Segment| match segment {
        Segment::Seq { index } => Some(index.to_string()),
        Segment::Map { key } => Some(key.clone()),
        Segment::Enum { variant } => Some(variant.clone()),
        Segment::Unknown => None,
    };
    path.iter().filter_map(step).collect()
}

/// Returns the value at a path, and the path itself without steps that are not there (the name of an enum's variant).
fn at(whole: &Value, mut path: Vec<String>) -> (Vec<String>, &Value) {
    let mut value = whole;
    for depth in 0..path.len() {
        let below = match value {
            Value::Array(list) => path[depth].parse::<usize>().ok().and_then(|index| list.get(index)),
            Value::Object(fields) => fields.get(&path[depth]),
            _ => None,
        };
        let Some(below) = below else {
            path.truncate(depth);
            return (path, value);
        };
        value = below;
    }
    (path, value)
}

/// Describes a fault in words that need no knowledge of the parser. `message` is the parser's.
fn described<T: DeserializeOwned>(whole: &Value, path: Vec<String>, message: &str) -> String {
    let within = |path: &[String], field: &str| match path {
        [] => field.to_owned(),
        _ => format!("{}.{field}", path.join(".")),
    };
    let quoted = |message: &str| message.split('`').nth(1).unwrap_or_default().to_owned();
    if message.starts_with("missing field") {
        return format!("{}: it is missing", within(&at(whole, path).0, &quoted(message)));
    }
    if message.starts_with("duplicate field") {
        return format!("{}: it is there twice", within(&at(whole, path).0, &quoted(message)));
    }
    if message.starts_with("unknown field") {
        let field = quoted(message);
        let mut table = path;
        if table.last() == Some(&field) {
            table.pop();
        }
        let known = words(message).join(", ");
        return format!("{}: there is no such field; there are {known}", within(&table, &field));
    }
    let (path, value) = at(whole, path);
    let field = if path.is_empty() { "it".to_owned() } else { path.join(".") };
    let choices = if message.starts_with("unknown variant") { words(message) } else { choices::<T>(whole, &path) };
    let expected = match message.rsplit_once("expected ") {
        _ if !choices.is_empty() && message.contains("newtype variant") => {
            format!("a number with it: {{{value}: NUMBER}}")
        }
        _ if !choices.is_empty() => one_of(&choices),
        Some((_, expected)) => plain(expected),
        None => return format!("{field}: {}; {message}", shown(value)),
    };
    format!("{field}: {}; expected {expected}", shown(value))
}

/// Returns the words in backticks of a parser's message after "expected".
fn words(message: &str) -> Vec<String> {
    let expected = message.split_once(", expected ").map_or("", |(_, expected)| expected);
    expected.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Returns the permitted words of the field at `path`; empty if it is no choice of words. A word that no field has is
/// tried in its place, because only then the parser names them.
fn choices<T: DeserializeOwned>(whole: &Value, path: &[String]) -> Vec<String> {
    let pointer: String = path.iter().map(|step| format!("/{}", step.replace('~', "~0").replace('/', "~1"))).collect();
    let mut tried = whole.clone();
    let Some(value) = tried.pointer_mut(&pointer) else { return Vec::new() };
    *value = Value::String(NO_WORD.to_owned());
    let Err(error) = T::deserialize(&tried) else { return Vec::new() };
    let message = error.to_string();
    if message.starts_with(&format!("unknown variant `{NO_WORD}`")) { words(&message) } else { Vec::new() }
}

fn one_of(words: &[String]) -> String {
    match words {
        [one] => one.clone(),
        [all @ .., last] => format!("{} or {last}", all.join(", ")),
        [] => String::new(),
    }
}

/// Returns what a parser expects, in words of people.
fn plain(expected: &str) -> String {
    let known = match expected {
        "usize" | "u64" | "u32" | "u16" | "u8" => "a whole number, 0 or more",
        "i64" | "i32" => "a whole number",
        "f32" | "f64" => "a number",
        "a string" | "string" | "a borrowed string" => "a text",
        "a sequence" => "a list",
        "a map" => "an object",
        "a boolean" => "true or false",
        _ if expected.starts_with("struct ") => "an object",
        _ => return expected.replace("an array of length", "a list of"),
    };
    known.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        version: u32,
        parts: Vec<Part>,
        #[serde(default)]
        names: Vec<String>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Part {
        form: Form,
        #[serde(default)]
        ends: Option<[f32; 2]>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Form {
        Flat,
        Bent(f32),
    }

    #[test]
    fn an_error_names_the_path_the_value_and_what_is_expected() {
        let error = |text: &str| parse::<Outer>(text).unwrap_err();
        let part = |part: &str| error(&format!("{{\"version\": 1, \"parts\": [{{\"form\": \"flat\"}}, {part}]}}"));
        for (said, expected) in [
            (part("{\"form\": \"round\"}"), "parts.1.form: \"round\"; expected flat or bent"),
            (part("{\"form\": true}"), "parts.1.form: true; expected flat or bent"),
            (part("{\"form\": 7}"), "parts.1.form: 7; expected flat or bent"),
            (part("{\"form\": \"bent\"}"), "parts.1.form: \"bent\"; expected a number with it: {\"bent\": NUMBER}"),
            (part("{\"form\": {\"bent\": \"much\"}}"), "parts.1.form.bent: \"much\"; expected a number"),
            (part("{\"form\": {\"bend\": 1}}"), "parts.1.form: {\"bend\":1}; expected flat or bent"),
            (part("{\"form\": \"flat\", \"ends\": [1]}"), "parts.1.ends: [1]; expected a list of 2"),
            (part("{\"form\": \"flat\", \"ends\": 1}"), "parts.1.ends: 1; expected a list of 2"),
            (part("{}"), "parts.1.form: it is missing"),
            (part("{\"form\": \"flat\", \"end\": 1}"), "parts.1.end: there is no such field; there are form, ends"),
            (part("5"), "parts.1: 5; expected an object"),
            (error("{\"version\": \"1\", \"parts\": []}"), "version: \"1\"; expected a whole number, 0 or more"),
            (error("{\"version\": -1, \"parts\": []}"), "version: -1; expected a whole number, 0 or more"),
            (error("{\"version\": 1, \"parts\": \"none\"}"), "parts: \"none\"; expected a list"),
            (error("{\"version\": 1, \"version\": 2}"), "version: it is there twice"),
            (error("{\"version\": 1, \"parts\": [], \"names\": [3]}"), "names.0: 3; expected a text"),
            (error("[]"), "it: []; expected an object"),
            (
                error("{\"version\": NaN}"),
                "it is not JSON: expected value near \"{\\\"version\\\": NaN}\"; JSON has no NaN and no infinity",
            ),
        ] {
            assert_eq!(said, expected);
        }
        assert!(parse::<Outer>("{\"version\": 1, \"parts\": [{\"form\": {\"bent\": 1.0}}]}").is_ok());
    }

    #[test]
    fn a_value_in_an_error_is_short_and_shows_no_key() {
        let key = "0f1e2d3c4b5a69788796a5b4c3d2e1f00f1e2d3c4b5a69788796a5b4c3d2e1f0";
        let error = parse::<Outer>(&format!("{{\"version\": \"{key}\"}}")).unwrap_err();
        assert!(error.contains("(hidden)") && !error.contains("0f1e2d3c"), "{error}");
        let error = parse::<Outer>(&format!("{{\"version\": \"{}\"}}", "x".repeat(500))).unwrap_err();
        assert!(error.len() < 150 && error.contains("..."), "{error}");
        let error = parse::<Outer>(&format!("{{\"version\": x{key}}}")).unwrap_err();
        assert!(!error.contains("0f1e2d3c"), "{error}");
    }
}
