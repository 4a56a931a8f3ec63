//! The page's HTML: one file, no script, nothing fetched.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::{Block, Report, base64::base64, text::printable};

/// How everything looks, on a bright or dark screen and on paper.
const STYLE: &str = include_str!("page.css");

/// What the page may load: what is in it. A browser then refuses anything else, should text ever get past the escaping.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// Headings from which on the page begins with a list of them.
const MIN_HEADINGS: usize = 4;

/// The whole page.
pub(super) fn html(report: &Report) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                // Without it a browser asks for one.
                link rel="icon" href="data:,";
                title { (printable(&report.title)) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (printable(&report.title)) }
                (contents(report))
                @for (index, piece) in report.blocks.iter().enumerate() { (block(index, piece)) }
            }
        }
    };
    page.into_string()
}

/// Links to the headings, when there are many.
fn contents(report: &Report) -> Markup {
    let headings = report
        .blocks
        .iter()
        .enumerate()
        .filter_map(|(index, block)| match block {
            Block::Heading(text) => Some((index, text)),
            Block::Text(_) | Block::Warning(_) | Block::Table { .. } | Block::Plot { .. } | Block::Picture { .. } => {
                None
            }
        });
    let headings: Vec<_> = headings.collect();
    html! {
        @if headings.len() >= MIN_HEADINGS {
            nav aria-label="Contents" {
                ul { @for (index, text) in headings { li { a href={ "#" (id(index)) } { (printable(text)) } } } }
            }
        }
    }
}

fn block(index: usize, block: &Block) -> Markup {
    match block {
        Block::Heading(text) => html! { h2 id=(id(index)) { (printable(text)) } },
        Block::Text(text) => html! { p { (printable(text)) } },
        Block::Warning(text) => html! { p class="warning" role="note" { strong { "Warning: " } (printable(text)) } },
        Block::Table { caption, head, rows } => table(caption, head, rows),
        Block::Plot { caption, plot } => html! {
            figure {
                figcaption { (printable(caption)) }
                div class="wide" { (plot.draw(caption)) }
            }
        },
        Block::Picture { caption, png } => html! {
            figure {
                figcaption { (printable(caption)) }
                img alt=(printable(caption)) src={ "data:image/png;base64," (base64(png)) };
            }
        },
    }
}

/// What links refer to.
fn id(index: usize) -> String {
    format!("part-{index}")
}

fn table(caption: &str, head: &[String], rows: &[Vec<String>]) -> Markup {
    // A column of numbers is read from its right end.
    let n_columns = rows.iter().map(Vec::len).fold(head.len(), usize::max);
    let classes: Vec<Option<&str>> = (0..n_columns)
        .map(|column| {
            let mut cells = rows
                .iter()
                .filter_map(|row| row.get(column))
                .filter(|cell| !cell.is_empty())
                .peekable();
            (cells.peek().is_some() && cells.all(|cell| is_number(cell))).then_some("number")
        })
        .collect();
    html! {
        div class="wide" {
            table {
                caption { (printable(caption)) }
                thead { tr {
                    @for (cell, class) in head.iter().zip(&classes) { th scope="col" class=[class] { (printable(cell)) } }
                } }
                tbody { @for row in rows { tr {
                    @for (cell, class) in row.iter().zip(&classes) { td class=[class] { (printable(cell)) } }
                } } }
            }
        }
    }
}

/// Whether a cell begins with a number, such as `0.12`, `-3 ± 1`, `12 px` or `–`, which stands for none.
fn is_number(cell: &str) -> bool {
    let mut signs = cell
        .trim_start_matches(['-', '+', '\u{2212}', '±', '<', '>', '≤', '≥', ' '])
        .chars();
    match signs.next() {
        Some(first) => first.is_ascii_digit() || cell == "–",
        None => cell == "-" || cell == "\u{2212}",
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::report::plot::{Axis, Plot, Series, Style};

    /// The page as XML, which it is but for elements that HTML does not close.
    fn as_xml(page: &str) -> String {
        let mut xml = String::new();
        let body = page.strip_prefix("<!DOCTYPE html>").expect("a type");
        let mut rest = body;
        while let Some(start) = ["<meta ", "<img ", "<link "]
            .iter()
            .filter_map(|tag| rest.find(tag))
            .min()
        {
            let end = start + rest[start..].find('>').expect("an end");
            xml += &rest[..end];
            xml.push_str("/>");
            rest = &rest[end + 1..];
        }
        xml + rest
    }

    fn texts(document: &roxmltree::Document<'_>, tag: &str) -> Vec<String> {
        let elements = document.descendants().filter(|node| node.has_tag_name(tag));
        let text = |node: roxmltree::Node<'_, '_>| {
            node.descendants()
                .filter_map(|n| n.text().filter(|_| n.is_text()))
                .collect()
        };
        elements.map(text).collect()
    }

    fn full(text: &str, number: f64) -> Report {
        let mut report = Report::new(text);
        for _ in 0..4 {
            report.push(Block::Heading(text.to_owned()));
        }
        report
            .push(Block::Text(text.to_owned()))
            .push(Block::Warning(text.to_owned()))
            .push(Block::Table {
                caption: text.to_owned(),
                head: vec![text.to_owned(), "σ".to_owned()],
                rows: vec![
                    vec![text.to_owned(), number.to_string()],
                    vec![text.to_owned()],
                    Vec::new(),
                ],
            })
            .push(Block::Plot {
                caption: text.to_owned(),
                plot: Plot::Chart {
                    x: Axis::linear(text),
                    y: Axis::logarithmic(text),
                    series: vec![Series {
                        name: text.to_owned(),
                        points: vec![[number, 1.0], [2.0, number]],
                        style: Style::Line,
                    }],
                },
            })
            .push(Block::Picture {
                caption: text.to_owned(),
                png: text.as_bytes().to_vec(),
            });
        report
    }

    proptest! {
        #[test]
        fn any_text_is_on_the_page_and_nothing_else_than_text(text in any::<String>(), number: f64) {
            let page = full(&text, number).to_html();
            let xml = as_xml(&page);
            let document = roxmltree::Document::parse(&xml).map_err(|error| TestCaseError::fail(error.to_string()))?;
            let shown = printable(&text).replace("\r\n", "\n");
            prop_assert_eq!(texts(&document, "h1"), vec![shown.clone()]);
            prop_assert_eq!(texts(&document, "h2"), vec![shown.clone(); 4]);
            prop_assert_eq!(texts(&document, "figcaption"), vec![shown; 2]);
            prop_assert_eq!(texts(&document, "script").len(), 0);
        }
    }

    #[test]
    fn markup_in_text_stays_text() {
        let report = full("<script>alert(\"1\")</script> & <b>'</b>", 0.5);
        let page = report.to_html();
        assert!(!page.contains("<script") && !page.contains("<b>"), "{page}");
        assert!(page.contains("&lt;script&gt;"));
    }

    #[test]
    fn nothing_is_fetched() {
        let page = full("text", 1.0).to_html();
        let allowed = "http://www.w3.org/2000/svg";
        assert_eq!(page.matches("://").count(), page.matches(allowed).count());
        assert!(!page.contains("url(") && !page.contains("@import"));
    }

    #[test]
    fn columns_of_numbers_are_known() {
        for cell in ["0.12", "-3 ± 1", "12 px", "–", "< 0.1", "\u{2212}2"] {
            assert!(is_number(cell), "{cell}");
        }
        for cell in ["", "view 3", "k1", "– none"] {
            assert!(!is_number(cell), "{cell}");
        }
    }
}
