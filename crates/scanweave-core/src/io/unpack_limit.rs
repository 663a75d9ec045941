//! How much a packed file may unpack to: one limit for archives, images and packed points.
//!
//! A deflate stream makes 1032 bytes of one, so that a file of some megabytes can fill any memory.

use super::scan_file::ReadOptions;
use crate::error::Error;
use std::path::Path;

const MIB: u64 = 1 << 20;
/// Every file may unpack to this: small ones of one repeated number are no bomb.
const FLOOR_BYTES: u64 = 64 * MIB;
/// Bytes that a packed byte may unpack to. Scans reach 2 to 20; grids that are mostly without returns,
/// some ten times as many.
const RATIO: u64 = 100;
/// From here on only [`LARGE_RATIO`] counts, as memory ends soon after.
const LARGE_BYTES: u64 = 4 << 30;
/// What scans reach without being mostly empty.
const LARGE_RATIO: u64 = 20;

/// The limit where the user sets none, for a file of so many bytes.
fn default_bytes(packed: u64) -> u64 {
    let small = packed.saturating_mul(RATIO).saturating_add(FLOOR_BYTES).min(LARGE_BYTES);
    small.max(packed.saturating_mul(LARGE_RATIO))
}

/// Most bytes that a file may unpack to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct UnpackLimit {
    bytes: u64,
    /// Whether the setting counts for this file.
    adjustable: bool,
}

impl UnpackLimit {
    /// For a scan of so many packed bytes.
    pub(super) fn of_scan(options: &ReadOptions, packed: u64) -> Self {
        let set = options.unpack_limit_mib.map(|mib| mib.saturating_mul(MIB));
        Self { bytes: set.unwrap_or_else(|| default_bytes(packed)), adjustable: true }
    }

    /// For features and caches of so many packed bytes.
    pub(super) fn of_other(packed: u64) -> Self {
        Self { bytes: default_bytes(packed), adjustable: false }
    }

    pub(super) fn bytes(self) -> u64 {
        self.bytes
    }

    /// The options with this limit, for what lies in the file and is packed itself.
    pub(super) fn kept_in(self, options: &ReadOptions) -> ReadOptions {
        ReadOptions { unpack_limit_mib: Some(self.bytes.div_ceil(MIB)), ..options.clone() }
    }

    /// The error for a file that holds more; `content` is what would be unpacked.
    pub(super) fn exceeded(self, path: &Path, content: &str) -> Error {
        let mib = self.bytes / MIB;
        let found = format!("{content} of more than {mib} MiB when unpacked");
        let (expected, remedy) = match self.adjustable {
            true => (
                format!("at most {mib} MiB (input.unpack_limit_mib)"),
                "raise the limit with --unpack-limit if the file is what it should be, or unpack it first",
            ),
            false => (format!("at most {mib} MiB for a file of this size"), "save it without compression"),
        };
        Error::file(path, found, expected, remedy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_follows_the_size_of_the_file_unless_it_is_set() {
        let of = |mib: Option<u64>, packed: u64| {
            let options = ReadOptions { unpack_limit_mib: mib, ..ReadOptions::default() };
            UnpackLimit::of_scan(&options, packed).bytes()
        };
        // 64 MiB and a hundredfold, up to 4 GiB; a twentyfold of files beyond.
        assert_eq!(of(None, 0), 67_108_864);
        assert_eq!(of(None, 1_000_000), 167_108_864);
        assert_eq!(of(None, 100_000_000), 4_294_967_296);
        assert_eq!(of(None, 1_000_000_000), 20_000_000_000);
        assert_eq!(of(None, u64::MAX), u64::MAX);
        assert_eq!(of(Some(3), 1_000_000_000), 3_145_728);
        assert_eq!(of(Some(u64::MAX), 1), u64::MAX);
        assert_eq!(UnpackLimit::of_other(1_000_000).bytes(), 167_108_864);
    }

    #[test]
    fn a_packed_file_in_a_packed_file_does_not_multiply_the_limit() {
        let outer = UnpackLimit::of_scan(&ReadOptions::default(), 1_000_000);
        let inner = UnpackLimit::of_scan(&outer.kept_in(&ReadOptions::default()), 100_000_000);
        // 167 108 864 bytes, rounded up to whole MiB.
        assert_eq!(inner.bytes(), 160 << 20);
    }

    #[test]
    fn the_message_names_the_setting_where_it_counts() {
        let path = Path::new("a.ply.gz");
        let said = UnpackLimit::of_scan(&ReadOptions::default(), 0).exceeded(path, "content").to_string();
        for part in ["a.ply.gz", "more than 64 MiB", "input.unpack_limit_mib", "--unpack-limit"] {
            assert!(said.contains(part), "{said}");
        }
        let said = UnpackLimit::of_other(0).exceeded(path, "arrays").to_string();
        assert!(!said.contains("--unpack-limit") && said.contains("without compression"), "{said}");
    }
}
