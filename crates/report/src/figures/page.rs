//! Report as a self-contained HTML page with text, tables and figures. It loads no other file, and follows the reader's
//! light or dark scheme.

use std::fmt::Write as _;

use crate::figures::Figure;

/// Part of a report page.
#[derive(Clone, Debug)]
pub enum Part<'a> {
    /// Heading of a section.
    Heading(String),
    /// Paragraph of text.
    Text(String),
    /// Text that keeps its line breaks and spaces, such as the output of a command.
    Verbatim(String),
    /// Table: column heads and rows.
    Table(Vec<&'a str>, Vec<Vec<String>>),
    /// List of terms, each with its definition.
    Terms(Vec<(String, String)>),
    /// Figure with its title and caption.
    Figure(&'a Figure),
}

const STYLE: &str = "\
:root{color-scheme:light dark}\
body{font:16px/1.5 system-ui,sans-serif;max-width:1200px;margin:2em auto;padding:0 1em;\
color:light-dark(#1a1a1a,#e8e8e8);background:light-dark(#fff,#16181a)}\
h1,h2{line-height:1.2}h2{margin-top:2em}\
.wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
th,td{padding:.3em .8em;text-align:right;border-bottom:1px solid light-dark(#ddd,#3a3d40);white-space:nowrap}\
th:first-child,td:first-child{text-align:left}\
pre{padding:.8em;overflow-x:auto;background:light-dark(#f3f3f3,#24272a)}\
dt{font-weight:600}dd{margin:0 0 .4em 1.2em;overflow-wrap:anywhere}\
figure{margin:1.5em 0;padding:8px;border:1px solid light-dark(#ddd,#3a3d40)}\
figure{--paper:light-dark(#fff,#16181a);--ink:light-dark(#000,#e8e8e8);--grey:light-dark(#6e6e6e,#a3a8ad);\
--blue:light-dark(#0072b2,#4aa8e8);--brown:light-dark(#d55e00,#ff8a3d);--green:light-dark(#009e73,#2fc79b)}\
figure svg{width:100%;height:auto;display:block}figcaption{padding:.5em 1em;max-width:75em}";

/// Escapes text for HTML.
fn plain(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Colours of the figures that follow the scheme of the page, by name: the other colours are as clear on dark as on
/// light ground. A figure's own file stays as it is, for papers.
const FOLLOWING: [(&str, &str); 6] = [
    ("#FFFFFF", "paper"),
    ("#000000", "ink"),
    ("#6E6E6E", "grey"),
    ("#0072B2", "blue"),
    ("#D55E00", "brown"),
    ("#009E73", "green"),
];

/// Returns a figure's drawing with colours that follow the scheme of the page.
fn drawing(figure: &Figure) -> String {
    let svg = figure.svg.trim().to_owned();
    FOLLOWING
        .iter()
        .fold(svg, |svg, (colour, name)| svg.replace(&format!("\"{colour}\""), &format!("\"var(--{name})\"")))
}

/// Returns the report page with this title and these parts as HTML.
pub fn page(title: &str, parts: &[Part]) -> String {
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{0}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{0}</h1>\n",
        plain(title)
    );
    for part in parts {
        // Writing to a string cannot fail.
        let _ = match part {
            Part::Heading(text) => writeln!(html, "<h2>{}</h2>", plain(text)),
            Part::Text(text) => writeln!(html, "<p>{}</p>", plain(text)),
            Part::Verbatim(text) => writeln!(html, "<pre>{}</pre>", plain(text)),
            Part::Table(heads, rows) => writeln!(html, "{}", table(heads, rows)),
            Part::Terms(terms) => {
                let term =
                    |(name, text): &(String, String)| format!("<dt>{}</dt><dd>{}</dd>", plain(name), plain(text));
                writeln!(html, "<dl>{}</dl>", terms.iter().map(term).collect::<String>())
            }
            Part::Figure(figure) => writeln!(
                html,
                "<figure role=\"img\" aria-label=\"{}\">\n{}\n<figcaption>{}</figcaption>\n</figure>",
                plain(&figure.title),
                drawing(figure),
                plain(&figure.caption)
            ),
        };
    }
    html + "</body>\n</html>\n"
}

fn table(heads: &[&str], rows: &[Vec<String>]) -> String {
    let heads: String = heads.iter().map(|head| format!("<th>{}</th>", plain(head))).collect();
    let cells = |row: &Vec<String>| row.iter().map(|cell| format!("<td>{}</td>", plain(cell))).collect::<String>();
    let rows: String = rows.iter().map(|row| format!("<tr>{}</tr>\n", cells(row))).collect();
    format!("<div class=\"wide\"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}</tbody>\n</table></div>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_follow_the_scheme_of_the_page() {
        let svg =
            "<svg><rect fill=\"#FFFFFF\"/><text fill=\"#000000\" stroke=\"#CC79A7\">#FFFFFF</text></svg>".to_owned();
        let (name, title, caption) = ("a".to_owned(), "a".to_owned(), "b".to_owned());
        let html = page("c", &[Part::Figure(&Figure { name, title, caption, svg })]);
        let drawn = "<rect fill=\"var(--paper)\"/><text fill=\"var(--ink)\" stroke=\"#CC79A7\">#FFFFFF</text>";
        assert!(html.contains(drawn), "{html}");
        assert!(!html.contains("background:#fff"), "no white slab in a dark page");
    }
}
