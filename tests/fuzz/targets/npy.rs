//! Any bytes as a .npy array.

#![no_main]
#![allow(dead_code, reason = "each target calls one of the readers")]

#[path = "../../common/untrusted.rs"]
mod untrusted;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| untrusted::array(bytes));
