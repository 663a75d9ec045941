//! Text from elsewhere (file names, headers, metadata) as text that is safe to show.
//!
//! A control character can drive a terminal (ESC sequences, C1 controls) or begin a line that looks like
//! one of ours; a format character can turn the order of what is read around (U+202E) or hide in a name
//! (U+200B). Both are written as escapes, so that a person sees that they are there. Everything that is
//! shown goes through this file; files for other programs keep the text as it is.

use std::borrow::Cow;
use std::fmt::Write;
use std::path::Path;

/// First and last code point of every range of format characters (general category Cf of Unicode 15.1
/// and 16), and of the separators of lines and paragraphs (Zl, Zp), in ascending order.
const FORMAT: [(char, char); 21] = [
    ('\u{ad}', '\u{ad}'),
    ('\u{600}', '\u{605}'),
    ('\u{61c}', '\u{61c}'),
    ('\u{6dd}', '\u{6dd}'),
    ('\u{70f}', '\u{70f}'),
    ('\u{890}', '\u{891}'),
    ('\u{8e2}', '\u{8e2}'),
    ('\u{180e}', '\u{180e}'),
    ('\u{200b}', '\u{200f}'),
    ('\u{2028}', '\u{202e}'),
    ('\u{2060}', '\u{2064}'),
    ('\u{2066}', '\u{206f}'),
    ('\u{feff}', '\u{feff}'),
    ('\u{fff9}', '\u{fffb}'),
    ('\u{110bd}', '\u{110bd}'),
    ('\u{110cd}', '\u{110cd}'),
    ('\u{13430}', '\u{1343f}'),
    ('\u{1bca0}', '\u{1bca3}'),
    ('\u{1d173}', '\u{1d17a}'),
    ('\u{e0001}', '\u{e0001}'),
    ('\u{e0020}', '\u{e007f}'),
];

/// Whether a character neither controls a terminal nor changes or hides what is read.
pub fn is_printable(c: char) -> bool {
    let is_format = || {
        let after = FORMAT.partition_point(|range| range.0 <= c);
        after.checked_sub(1).is_some_and(|i| c <= FORMAT[i].1)
    };
    !c.is_control() && (c.is_ascii() || !is_format())
}

/// Text for one line: `\n`, `\u{1b}` and the like in the place of the characters themselves.
///
/// Doing it twice changes nothing: a backslash stays as it is.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, is_printable)
}

/// [`printable`] for text of several lines: line feeds stay.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| c == '\n' || is_printable(c))
}

/// The first characters of a text, at most `longest` of them, for one line of a message.
pub fn printable_start(text: &str, longest: usize) -> String {
    let end = text.char_indices().nth(longest).map(|(at, _)| at);
    let mut shown = printable(&text[..end.unwrap_or(text.len())]).into_owned();
    if end.is_some() {
        shown.push('…');
    }
    shown
}

/// The name of a file or folder for one line of a message.
pub fn printable_path(path: &Path) -> String {
    match path.to_string_lossy() {
        Cow::Borrowed(text) => printable(text).into_owned(),
        Cow::Owned(text) => printable(&text).into_owned(),
    }
}

/// JSON with the escapes of JSON in the place of what is not printable: a program reads the same text
/// from it. Outside strings JSON has no such character but line feeds, which stay.
pub fn printable_json(json: &str) -> Cow<'_, str> {
    if json.chars().all(|c| c == '\n' || is_printable(c)) {
        return Cow::Borrowed(json);
    }
    let mut out = String::with_capacity(json.len() + json.len() / 16);
    for c in json.chars() {
        if c == '\n' || is_printable(c) {
            out.push(c);
        } else {
            for unit in c.encode_utf16(&mut [0; 2]) {
                write!(out, "\\u{unit:04x}").ok();
            }
        }
    }
    Cow::Owned(out)
}

fn escaped(text: &str, keeps: impl Fn(char) -> bool) -> Cow<'_, str> {
    if text.chars().all(&keeps) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if keeps(c) { out.push(c) } else { out.extend(c.escape_default()) }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Error, Result};
    use proptest::prelude::*;
    use std::io;

    /// What must never be shown as it is.
    fn hostile() -> impl Strategy<Value = String> {
        let known = ["\u{1b}[2J", "\u{1b}]0;x\u{7}", "\u{9b}31m", "\r\n", "\u{202e}", "\u{2066}", "\u{200f}"];
        let ranges = (0..FORMAT.len(), any::<u32>()).prop_map(|(i, k)| {
            let (first, last) = (FORMAT[i].0 as u32, FORMAT[i].1 as u32);
            char::from_u32(first + k % (last - first + 1)).unwrap_or('\u{feff}').to_string()
        });
        let controls = (0u32..0xa0).prop_map(|c| char::from_u32(c).unwrap_or('\0').to_string());
        let part = prop_oneof![
            proptest::sample::select(known.to_vec()).prop_map(str::to_owned),
            ranges,
            controls,
            any::<char>().prop_map(String::from),
        ];
        proptest::collection::vec(part, 0..12).prop_map(|parts| parts.concat())
    }

    /// One error of every kind, with `text` wherever text can be.
    fn every_error(text: &str) -> Vec<Error> {
        let reason = || io::Error::other(text.to_owned());
        vec![
            Error::read(text, reason()),
            Error::write(text, reason()),
            Error::file(text, text, text, text),
            Error::not_a_scan(text, text, text, text),
            Error::setting(text, text, text, text),
            Error::input(text, text, text, text),
            Error::OutputExists { path: text.into() },
            Error::Interrupted { stage: text.to_owned() },
        ]
    }

    /// By the standard library's own table: `escape_debug` escapes what is not printable.
    fn std_escapes(c: char) -> bool {
        c.escape_debug().len() > 1 && !matches!(c, '"' | '\'' | '\\')
    }

    proptest! {
        #[test]
        fn no_message_holds_a_control_or_format_character(text in hostile()) {
            for error in every_error(&text) {
                let message = error.to_string();
                prop_assert!(message.chars().all(is_printable), "{message:?}");
            }
            let lines = printable_lines(&text);
            prop_assert!(lines.chars().all(|c| c == '\n' || is_printable(c)), "{lines:?}");
            prop_assert_eq!(lines.matches('\n').count(), text.matches('\n').count());
            let json = serde_json::to_string(&text).unwrap();
            let shown = printable_json(&json).into_owned();
            prop_assert!(shown.chars().all(is_printable), "{shown:?}");
            prop_assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), text);
        }
    }

    /// Unicode 16: 170 characters of category Cf (UnicodeData.txt), 65 of Cc, one each of Zl and Zp.
    #[test]
    fn exactly_the_control_and_format_characters_are_not_printable() {
        let all: Vec<char> = ('\0'..=char::MAX).filter(|&c| !is_printable(c)).collect();
        assert_eq!(all.len(), 170 + 65 + 2);
        for c in all {
            assert!(std_escapes(c), "{:x} is printable", c as u32);
        }
        for c in "\u{202a}\u{202b}\u{202c}\u{202d}\u{202e}\u{2066}\u{2067}\u{2068}\u{2069}\u{200e}\u{200f}\u{feff}\u{85}\u{7f}".chars() {
            assert!(!is_printable(c), "{:x}", c as u32);
        }
    }

    #[test]
    fn what_people_write_stays_as_it_is() -> Result<()> {
        for text in
            ["Küche größe", "走査 スキャン 스캔", "🙂🏠❤\u{fe0f}", "e\u{301} עברית عربى", "a\\b \u{fffd}", ""]
        {
            assert!(matches!(printable(text), Cow::Borrowed(t) if t == text));
            assert!(Error::file(text, "f", "e", "r").to_string().starts_with(text));
        }
        assert_eq!(printable("a\u{1b}[2Jb\n\u{202e}c\u{9b}"), r"a\u{1b}[2Jb\n\u{202e}c\u{9b}");
        assert_eq!(printable(&printable("a\u{1b}")), r"a\u{1b}");
        assert_eq!(printable_start("äöü\n4567", 4), "äöü\\n…");
        assert_eq!(printable_start("äöü", 3), "äöü");
        // U+E0001 is DB40 DC01 in UTF-16.
        assert_eq!(printable_json("\"\u{e0001}\u{7f}\"\n"), "\"\\udb40\\udc01\\u007f\"\n");
        Ok(())
    }
}
