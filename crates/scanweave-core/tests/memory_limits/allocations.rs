//! An allocator that keeps count, so that a test sees the most memory that a call asked for.
//!
//! Every thread has a count of its own: readers do all their work on the thread that calls them, and tests run
//! beside each other.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::{Duration, Instant};

struct Counting;

thread_local! {
    /// Bytes that live now and that lived at most. Negative where a thread freed what another had made.
    static LIVE_AND_PEAK: Cell<[isize; 2]> = const { Cell::new([0; 2]) };
}

fn add(bytes: isize) {
    // A thread that ends may free after its count is gone.
    let _ = LIVE_AND_PEAK.try_with(|count| {
        let [live, peak] = count.get();
        let live = live.saturating_add(bytes);
        count.set([live, peak.max(live)]);
    });
}

fn grow(bytes: usize) {
    add(isize::try_from(bytes).unwrap_or(isize::MAX));
}

fn shrink(bytes: usize) {
    add(isize::try_from(bytes).map_or(isize::MIN, |bytes| -bytes));
}

// SAFETY: every call goes to the system's allocator with the same arguments; counting touches no memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // Counted in full, though the system hands out zeroed pages only when they are touched.
        grow(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Large blocks grow by pages that are moved, not copied: the old ones do not count again.
        grow(size.saturating_sub(layout.size()));
        shrink(layout.size().saturating_sub(size));
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        shrink(layout.size());
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What a call asked for.
#[derive(Debug, Clone, Copy)]
pub struct Cost {
    /// Most bytes that were allocated at a time, beyond those before the call.
    pub peak_bytes: usize,
    pub took: Duration,
}

/// The outcome of a call, and its cost.
pub fn cost_of<T>(call: impl FnOnce() -> T) -> (T, Cost) {
    let before = LIVE_AND_PEAK.get()[0];
    LIVE_AND_PEAK.set([before; 2]);
    let start = Instant::now();
    let outcome = call();
    let took = start.elapsed();
    let peak_bytes = LIVE_AND_PEAK.get()[1].saturating_sub(before).unsigned_abs();
    (outcome, Cost { peak_bytes, took })
}
