//! Text as a page can hold it.

use std::borrow::Cow;

/// The text without what neither HTML nor XML allows (control characters and two more; XML 1.0, section 2.2), which is shown
/// as `�`. Signs with a meaning in HTML are not its business: `maud` escapes them.
pub(super) fn printable(text: &str) -> Cow<'_, str> {
    let is_allowed = |c: char| {
        matches!(c, '\t' | '\n' | '\u{20}'..='\u{7e}' | '\u{a0}'..='\u{fffd}' | '\u{10000}'..)
            && !matches!(c, '\u{fdd0}'..='\u{fdef}')
    };
    if text.chars().all(is_allowed) {
        return Cow::Borrowed(text);
    }
    let shown = text.chars().map(|c| if is_allowed(c) { c } else { '\u{fffd}' });
    Cow::Owned(shown.collect())
}
