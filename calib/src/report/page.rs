//! The page's HTML.

use maud::{DOCTYPE, Markup, html};

use super::{Block, Report};

/// The whole page.
pub(super) fn html(report: &Report) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                title { (report.title) }
            }
            body {
                h1 { (report.title) }
                @for piece in &report.blocks { (block(piece)) }
            }
        }
    };
    page.into_string()
}

fn block(block: &Block) -> Markup {
    match block {
        Block::Heading(text) => html! { h2 { (text) } },
        Block::Text(text) => html! { p { (text) } },
        Block::Warning(text) => html! { p.warning { (text) } },
        Block::Table { caption, head, rows } => html! {
            table {
                caption { (caption) }
                thead { tr { @for cell in head { th { (cell) } } } }
                tbody { @for row in rows { tr { @for cell in row { td { (cell) } } } } }
            }
        },
        Block::Plot { caption, .. } | Block::Picture { caption, .. } => html! { figure { figcaption { (caption) } } },
    }
}
