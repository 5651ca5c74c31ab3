//! The system's allocator, which also counts: how many bytes are allocated now, and how often memory was asked for.

#![allow(dead_code, reason = "each test file uses one of the counts")]
#![allow(unsafe_code, reason = "an allocator that counts has no other way")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicIsize, AtomicUsize, Ordering};

/// The allocator.
struct Counting;

/// Bytes that are allocated now.
pub(crate) static ALLOCATED: AtomicIsize = AtomicIsize::new(0);

/// How often memory was asked for.
pub(crate) static ASKED: AtomicUsize = AtomicUsize::new(0);

// SAFETY: everything is passed on as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATED.fetch_add(layout.size() as isize, Ordering::Relaxed);
        ASKED.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promise is the one asked for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        ALLOCATED.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        // SAFETY: the caller's promise is the one asked for.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;
