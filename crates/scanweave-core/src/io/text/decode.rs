//! From a file's bytes to lines of text, whatever its encoding and line ends.

use std::borrow::Cow;

/// Byte order marks of UTF-16.
const UTF16_LE: [u8; 2] = [0xff, 0xfe];
const UTF16_BE: [u8; 2] = [0xfe, 0xff];

/// Whether the bytes say that they are UTF-16, whose characters hold zero bytes.
pub(in crate::io) fn is_utf16(bytes: &[u8]) -> bool {
    bytes.starts_with(&UTF16_LE) || bytes.starts_with(&UTF16_BE)
}

/// The text of `bytes`: UTF-8, or UTF-16 where a mark says so. Lines end in a line feed.
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let text = match bytes.strip_prefix(&UTF16_LE) {
        Some(rest) => Cow::Owned(utf16(rest, u16::from_le_bytes)),
        None => match bytes.strip_prefix(&UTF16_BE) {
            Some(rest) => Cow::Owned(utf16(rest, u16::from_be_bytes)),
            None => String::from_utf8_lossy(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)),
        },
    };
    // A return alone ends a line too. Left in, it would join rows, and all but the first would be lost.
    let lone = text.match_indices('\r').any(|(at, _)| text.as_bytes().get(at + 1) != Some(&b'\n'));
    if lone { Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n")) } else { text }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let (pairs, _) = bytes.as_chunks::<2>();
    let units: Vec<u16> = pairs.iter().map(|&pair| unit(pair)).collect();
    String::from_utf16_lossy(&units)
}
