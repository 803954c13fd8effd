//! Text for people: counts with their nouns, and text from outside without the control characters that a terminal would
//! obey.

use std::borrow::Cow;
use std::fmt::{Display, Write as _};

/// Which control characters of a text are layout and stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Tabs alone: the text is one line, or one value within a line.
    Line,
    /// Tabs and line ends: the text is whole lines of this program's own making, such as a table.
    Lines,
}

/// Returns `text` with every character that controls a terminal, or the direction of what is written, replaced by the
/// escape that JSON has for it, such as `\u001b`. So a text from outside (a file's name, a value in it, a line of a
/// driver) can neither end its line nor change what is shown before or after it, and JSON keeps its meaning.
pub fn printable(text: &str, layout: Layout) -> Cow<'_, str> {
    let stays = |c: char| c == '\t' || c == '\n' && layout == Layout::Lines;
    if !text.contains(|c| controls(c) && !stays(c)) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            _ if stays(c) || !controls(c) => shown.push(c),
            '\n' => shown.push_str("\\n"),
            '\r' => shown.push_str("\\r"),
            // All of these are in the basic plane, so four digits are enough.
            _ => write!(shown, "\\u{:04x}", u32::from(c)).expect("a string takes all"),
        }
    }
    Cow::Owned(shown)
}

/// Returns the value as one line that no terminal obeys: [`printable`] with [`Layout::Line`].
pub fn value(value: impl Display) -> String {
    let text = value.to_string();
    match printable(&text, Layout::Line) {
        Cow::Borrowed(_) => text,
        Cow::Owned(shown) => shown,
    }
}

/// Whether a character controls the terminal (C0, DEL, C1), the direction of text (Unicode, UAX 9), or ends a line.
fn controls(c: char) -> bool {
    let turns = matches!(c, '\u{061c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() || turns || matches!(c, '\u{2028}' | '\u{2029}')
}

/// Returns a count with its noun, which gets its plural unless the count is 1: "1 robot", "5 robots", "2 policies".
pub fn counted(count: impl Display, noun: &str) -> String {
    let count = count.to_string();
    if count == "1" {
        return format!("{count} {noun}");
    }
    match noun.strip_suffix('y') {
        Some(stem) if !stem.ends_with(['a', 'e', 'o', 'u']) => format!("{count} {stem}ies"),
        _ if noun.ends_with('s') => format!("{count} {noun}es"),
        _ => format!("{count} {noun}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_obeys_is_shown_and_the_rest_is_unchanged() {
        let line = |text: &str| printable(text, Layout::Line).into_owned();
        assert_eq!(line("a\x1b[2Jb\r\nc\x07"), "a\\u001b[2Jb\\r\\nc\\u0007");
        assert_eq!(line("\u{9b}31m \u{7f} \u{202e}gpj"), "\\u009b31m \\u007f \\u202egpj");
        assert_eq!(line("tab\there, \u{fc}ber \u{4e2d}\u{6587} \\n"), "tab\there, \u{fc}ber \u{4e2d}\u{6587} \\n");
        assert_eq!(printable("one\ntwo\x1b\n", Layout::Lines), "one\ntwo\\u001b\n");
        assert!(matches!(printable("plain\n", Layout::Lines), Cow::Borrowed(_)));
    }

    #[test]
    fn json_keeps_its_meaning() {
        let text = "\u{202e}a\u{9b}b\x7f\x1b\n";
        let json = serde_json::to_string(text).unwrap();
        let shown = printable(&json, Layout::Lines);
        assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), text);
        assert!(!shown.contains(controls), "{shown}");
    }

    #[test]
    fn one_is_singular() {
        assert_eq!(counted(1, "robot"), "1 robot");
        assert_eq!(counted(0, "robot"), "0 robots");
        assert_eq!((counted(2u32, "policy"), counted(3, "day")), ("2 policies".to_owned(), "3 days".to_owned()));
        assert_eq!(counted(4, "process"), "4 processes");
    }
}
