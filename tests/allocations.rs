//! A tracked frame allocates no heap memory, because all buffers are kept. A daemon that runs for
//! weeks must not fragment memory, and an allocation may wait for another thread's lock.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::{Dolly, EntryContent, FrameSource, State, Tracker, TrackerSetup, dolly};

/// The system allocator, with a count of the allocations of each thread.
struct Counting;

thread_local! {
    static ASKED: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system allocator unchanged; counting only touches a thread-local
// number.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // A thread that is ending has no counter any more.
        let _ = ASKED.try_with(|asked| asked.set(asked.get() + 1));
        // SAFETY: the caller upholds the system allocator's contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Frames until every list has grown to the size that this clip needs.
const WARM_UP: usize = 50;
/// Counted frames: more than one period of everything that runs only now and then (the twin's
/// audit, the trial of the enlargement).
const COUNTED: usize = 40;

#[test]
fn tracking_a_frame_allocates_nothing() {
    let choice = Dolly { width: 640, height: 480, seed: 4, duration_s: 3.0, artwork_width: 1000 };
    let mut camera = VirtualCamera::new(dolly(choice).expect("a scene"), 30.0, (WARM_UP + COUNTED) as u64);
    let rows: Vec<_> = std::iter::from_fn(|| camera.next_entry()).collect();
    let mut tracker = Tracker::new(TrackerSetup::from(camera.stage())).expect("a setup that fits");
    let mut counts = Vec::with_capacity(rows.len());
    for row in &rows {
        let EntryContent::Frame(frame) = &row.content else { panic!("a virtual camera loses no frame") };
        let before = ASKED.get();
        let sample = tracker.track(frame).expect("a virtual camera's frame");
        counts.push((ASKED.get() - before, sample.state));
    }
    println!("allocations, frame by frame: {:?}", counts.iter().map(|(n, _)| *n).collect::<Vec<_>>());
    // Proves that the counter works: the first frame allocates features and initial lists.
    assert!(counts[0].0 > 10);
    assert_eq!(counts.len(), WARM_UP + COUNTED);
    assert!(counts[WARM_UP..].iter().all(|(n, state)| *n == 0 && *state == State::Tracking));
}
