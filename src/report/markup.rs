//! HTML from templates and text.

use crate::files::printable_lines;
use crate::result::PAGE_MARK;
use crate::result::RunReport;

/// A template with the values in the place of its marks `<!--name-->`, which stand in the same
/// order. A mark is looked for in the template only, never in a value.
pub(super) fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let mut page = String::with_capacity(template.len() + values.iter().map(|v| v.1.len()).sum::<usize>());
    let mut rest = template;
    for (name, value) in values {
        if let Some((before, after)) = rest.split_once(&format!("<!--{name}-->")) {
            page.push_str(before);
            page.push_str(value);
            rest = after;
        }
    }
    page + rest
}

/// What a page says of the run that it shows; nothing where the run has no id.
pub(super) fn run_mark(run: &RunReport) -> String {
    run.run_id.as_deref().map(|id| format!("{PAGE_MARK}{}\">", escaped(id))).unwrap_or_default()
}

/// Text as the content of an HTML element or a quoted attribute, made printable.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in printable_lines(text).chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_put_in_once_and_marks_in_them_stay_text() {
        let page = filled("a<!--x-->b<!--y-->c", &[("x", "<!--y-->"), ("y", "2")]);
        assert_eq!(page, "a<!--y-->b2c");
        assert_eq!(escaped("a\u{202e}b\n"), "a\\u{202e}b\n");
        assert_eq!(escaped("<a b=\"'\">&amp;"), "&lt;a b=&quot;&#39;&quot;&gt;&amp;amp;");
    }
}
