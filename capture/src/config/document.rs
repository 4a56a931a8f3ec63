//! A TOML text and where in it things are: turns what a reader says into errors with line and key.

use std::fmt::{Display, Write as _};
use std::ops::{Range, RangeInclusive};
use std::path::Path;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::error::ConfigError;

/// Least likeness (Jaro and Winkler, 1 is equal) at which a known key is offered for an unknown one. Measured on our
/// keys: `rate_fps` and `rate_hz` have 0.87, keys of a camera that have nothing to do with each other at most 0.66.
const LIKENESS_MIN: f64 = 0.75;

/// Longest value shown in an error, in characters.
const SHOWN_MAX: usize = 60;

/// A TOML text, parsed as far as to know where each key is.
pub(super) struct Document<'t> {
    path: &'t Path,
    text: &'t str,
    root: DeTable<'t>,
}

impl<'t> Document<'t> {
    pub(super) fn parse(path: &'t Path, text: &'t str) -> Result<Self, ConfigError> {
        match DeTable::parse(text) {
            Ok(root) => Ok(Self {
                path,
                text,
                root: root.into_inner(),
            }),
            Err(error) => Err(ConfigError::Syntax {
                path: path.to_owned(),
                line: line_at(text, error.span().map_or(0, |span| span.start)),
                message: error.message().replace('\n', ", "),
            }),
        }
    }

    /// Reads the document into a structure of serde's.
    pub(super) fn read<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        toml::from_str(self.text).map_err(|error| self.explain(error.message(), error.span()))
    }

    /// The error for a value that is not allowed.
    pub(super) fn refuse(&self, key: &str, found: &dyn Display, allowed: impl Into<String>) -> ConfigError {
        ConfigError::Value {
            path: self.path.to_owned(),
            line: self.line_of(key),
            key: key.to_owned(),
            found: shown(&found.to_string()),
            allowed: allowed.into(),
        }
    }

    /// Checks that a number is in a range.
    pub(super) fn number(&self, key: &str, value: f64, allowed: RangeInclusive<f64>) -> Result<f64, ConfigError> {
        if allowed.contains(&value) {
            return Ok(value);
        }
        Err(self.refuse(key, &value, format!("{} to {}", allowed.start(), allowed.end())))
    }

    /// Checks that a whole number is in a range.
    pub(super) fn whole(&self, key: &str, value: i64, allowed: RangeInclusive<u32>) -> Result<u32, ConfigError> {
        let whole = u32::try_from(value).ok().filter(|whole| allowed.contains(whole));
        whole.ok_or_else(|| self.refuse(key, &value, format!("{} to {}", allowed.start(), allowed.end())))
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        self.path
    }

    /// Line of a key such as `camera[1].rate_hz`; of what it is in where it is left out.
    pub(super) fn line_of(&self, key: &str) -> usize {
        let mut table = &self.root;
        let mut offset = 0;
        for part in key.split('.') {
            let (name, index) = split_index(part);
            let Some((found, value)) = table.get_key_value(name) else {
                break;
            };
            offset = found.span().start;
            let mut value = value.get_ref();
            if let (Some(index), DeValue::Array(array)) = (index, value) {
                let Some(element) = array.get(index) else { break };
                offset = element.span().start;
                value = element.get_ref();
            }
            let DeValue::Table(inner) = value else { break };
            table = inner;
        }
        line_at(self.text, offset)
    }

    /// The innermost key with this part of the text in its value, or that is itself there.
    fn key_at(&self, span: &Range<usize>) -> String {
        let mut key = String::new();
        find(&self.root, span, &mut key);
        key
    }

    /// Makes an error of what serde said. Its words for unknown and missing fields are part of its interface; should
    /// they ever change, the message is shown as it is.
    fn explain(&self, message: &str, span: Option<Range<usize>>) -> ConfigError {
        let span = span.unwrap_or(0..0);
        let (path, line) = (self.path.to_owned(), line_at(self.text, span.start));
        let mut quoted = message.split('`').skip(1).step_by(2).map(str::to_owned);
        let first = quoted.next().unwrap_or_default();
        if message.starts_with("unknown field") {
            let known: Vec<String> = quoted.collect();
            return ConfigError::UnknownKey {
                path,
                line,
                nearest: nearest(&first, &known),
                key: first,
                known,
            };
        }
        if message.starts_with("missing field") {
            let place = self.key_at(&span);
            let key = if place.is_empty() {
                first
            } else {
                format!("{place}.{first}")
            };
            return ConfigError::MissingKey { path, line, key };
        }
        let key = self.key_at(&span);
        if message.starts_with("unknown variant") {
            let known: Vec<String> = quoted.collect();
            let mut allowed = format!("`{}`", known.join("`, `"));
            if let Some(nearest) = nearest(&first, &known) {
                let _ = write!(allowed, "; did you mean `{nearest}`?");
            }
            return ConfigError::Value {
                path,
                line,
                key,
                found: shown(&first),
                allowed,
            };
        }
        ConfigError::WrongKind {
            path,
            line,
            key,
            message: shown(message),
        }
    }
}

/// Finds the innermost key around `span` and appends it, with the tables it is in, to `key`.
fn find(table: &DeTable<'_>, span: &Range<usize>, key: &mut String) {
    let is_around = |outer: &Range<usize>| outer.start <= span.start && span.end <= outer.end;
    for (name, value) in table {
        // The table of `[camera.gain_table]` has the span of its header: what is in it is looked at all the same.
        if !(is_around(&name.span()) || is_around(&value.span()) || contains(value.get_ref(), span)) {
            continue;
        }
        if !key.is_empty() {
            key.push('.');
        }
        key.push_str(name.get_ref());
        match value.get_ref() {
            DeValue::Table(inner) => find(inner, span, key),
            DeValue::Array(array) => {
                for (index, element) in array.iter().enumerate() {
                    if let DeValue::Table(inner) = element.get_ref()
                        && (is_around(&element.span()) || contains(element.get_ref(), span))
                    {
                        let _ = write!(key, "[{index}]");
                        find(inner, span, key);
                        break;
                    }
                }
            }
            DeValue::String(_)
            | DeValue::Integer(_)
            | DeValue::Float(_)
            | DeValue::Boolean(_)
            | DeValue::Datetime(_) => {}
        }
        return;
    }
}

/// True if `span` is within something inside this value.
fn contains(value: &DeValue<'_>, span: &Range<usize>) -> bool {
    let is_around = |outer: Range<usize>| outer.start <= span.start && span.end <= outer.end;
    match value {
        DeValue::Table(table) => table
            .iter()
            .any(|(name, value)| is_around(name.span()) || is_around(value.span()) || contains(value.get_ref(), span)),
        DeValue::Array(array) => array
            .iter()
            .any(|element| is_around(element.span()) || contains(element.get_ref(), span)),
        DeValue::String(_) | DeValue::Integer(_) | DeValue::Float(_) | DeValue::Boolean(_) | DeValue::Datetime(_) => {
            false
        }
    }
}

/// Splits `camera[1]` into name and index.
fn split_index(part: &str) -> (&str, Option<usize>) {
    match part.strip_suffix(']').and_then(|part| part.split_once('[')) {
        Some((name, index)) => (name, index.parse().ok()),
        None => (part, None),
    }
}

/// The known key that is most like an unknown one, if it is like it at all.
fn nearest(unknown: &str, known: &[String]) -> Option<String> {
    let likeness = |key: &String| strsim::jaro_winkler(unknown, key);
    let nearest = known.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)))?;
    (likeness(nearest) >= LIKENESS_MIN).then(|| nearest.clone())
}

/// Number of the line, from 1, in which a byte of the text is.
fn line_at(text: &str, offset: usize) -> usize {
    1 + text.as_bytes()[..offset.min(text.len())]
        .iter()
        .filter(|&&byte| byte == b'\n')
        .count()
}

/// A value on one line, cut where it is long.
fn shown(value: &str) -> String {
    let mut shown: String = value
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .take(SHOWN_MAX)
        .collect();
    if value.chars().nth(SHOWN_MAX).is_some() {
        shown.push('…');
    }
    shown
}
