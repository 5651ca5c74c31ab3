//! Any bytes as a recording.

#![no_main]
#![allow(dead_code, reason = "each target calls one of the readers")]

#[path = "../../common/untrusted.rs"]
mod untrusted;

use std::sync::LazyLock;

static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| tempfile::tempdir().unwrap());

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| untrusted::recording(bytes, FOLDER.path()));
