//! A target for the kind of file that the program is named after.
#![no_main]

#[allow(dead_code, reason = "the damaged files of the core's tests need more of it")]
#[path = "../crates/scanweave-core/tests/mutations/documents/mod.rs"]
mod documents;

use documents::{Document, Place, named};
use libfuzzer_sys::{Corpus, fuzz_target};
use std::panic::{self, AssertUnwindSafe};
use std::sync::{LazyLock, Mutex, PoisonError};

static DOCUMENT: LazyLock<&Document> =
    LazyLock::new(|| named(env!("CARGO_BIN_NAME")).unwrap_or_else(|| panic!("no such document")));
static PLACE: LazyLock<Place> = LazyLock::new(|| Place::new(env!("CARGO_BIN_NAME")));
/// What the last panic said. Readers catch the panics of some decoders: only one that gets through counts.
static SAID: Mutex<String> = Mutex::new(String::new());

fuzz_target!(
    init: panic::set_hook(Box::new(|info| {
        *SAID.lock().unwrap_or_else(PoisonError::into_inner) = info.to_string();
    })),
    |bytes: &[u8]| -> Corpus {
        if panic::catch_unwind(AssertUnwindSafe(|| DOCUMENT.read(&PLACE, bytes))).is_err() {
            eprintln!("{}", SAID.lock().unwrap_or_else(PoisonError::into_inner));
            std::process::abort();
        }
        Corpus::Keep
    }
);
