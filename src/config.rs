//! Reading configuration: TOML whose errors fit on one line and show the line that is wrong.

use serde::de::DeserializeOwned;

/// Reads a value; the error says which line is wrong, what stands there, and why.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    toml::from_str(text).map_err(|error| {
        let why = error.message().replace('\n', ": ");
        let Some(span) = error.span() else { return why };
        let before = &text[..span.start.min(text.len())];
        let number = before.matches('\n').count();
        let line = text.lines().nth(number).unwrap_or_default().trim();
        format!("line {} ({line}): {why}", number + 1)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn an_error_shows_the_line() {
        let error = from_toml::<BTreeMap<String, u32>>("robots = 5\nhosts = \"five\"\n").unwrap_err();
        assert!(error.starts_with("line 2 (hosts = \"five\"): invalid type"), "{error}");
        assert!(!error.contains('\n'));
    }
}
