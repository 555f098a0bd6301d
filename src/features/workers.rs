//! Worker threads within one frame: the same pure function over the pieces of a slice.
//!
//! Every piece is computed independently and stored at its own index, so the result does not depend
//! on the number of threads. One worker means the calling thread, without a pool.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::compute_clock::{ComputeClock, Stopwatch};

/// A fixed number of workers.
#[derive(Debug, Default)]
pub struct Workers {
    pool: Option<rayon::ThreadPool>,
    clock: ComputeClock,
    /// CPU time of the pool's threads since the last [`Workers::take_extra_ms`], nanoseconds.
    extra_ns: AtomicU64,
}

impl Workers {
    /// Creates `threads` workers (0 counts as 1). If the system refuses threads, the calling thread
    /// does all the work.
    pub fn new(threads: usize) -> Self {
        let build = |n| rayon::ThreadPoolBuilder::new().num_threads(n).thread_name(|k| format!("worker-{k}")).build().ok();
        let pool = (threads > 1).then(|| build(threads)).flatten();
        Self { pool, clock: ComputeClock::default(), extra_ns: AtomicU64::new(0) }
    }

    /// Creates one per processor, for start-up, when there are no frames yet. Frames use as many as
    /// configured.
    pub fn of_all_processors() -> Self {
        Self::new(std::thread::available_parallelism().map_or(1, usize::from))
    }

    /// Measures their work with `clock`.
    pub fn measured_with(self, clock: ComputeClock) -> Self {
        Self { clock, ..self }
    }

    /// Computes `output[k] = compute(&input[k])` for every k.
    pub fn map_into<T: Sync, U: Send>(&self, input: &[T], output: &mut Vec<U>, compute: impl Fn(&T) -> U + Sync) {
        let Some(pool) = &self.pool else {
            output.clear();
            output.extend(input.iter().map(compute));
            return;
        };
        let busy = AtomicU64::new(0);
        let piece = input.len().div_ceil(4 * pool.current_num_threads()).max(1);
        pool.install(|| {
            input
                .par_iter()
                .with_min_len(piece)
                .map_init(|| Busy { watch: self.clock.start(), total: &busy }, |_, x| compute(x))
                .collect_into_vec(output);
        });
        // The calling thread only waited meanwhile.
        self.extra_ns.fetch_add(busy.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// Runs `compute` on every element in place.
    pub fn for_each<T: Send>(&self, items: &mut [T], compute: impl Fn(&mut T) + Sync) {
        let Some(pool) = &self.pool else {
            items.iter_mut().for_each(compute);
            return;
        };
        let busy = AtomicU64::new(0);
        pool.install(|| {
            items.par_iter_mut().with_max_len(1).for_each(|x| {
                let _watch = Busy { watch: self.clock.start(), total: &busy };
                compute(x);
            });
        });
        // The calling thread only waited meanwhile.
        self.extra_ns.fetch_add(busy.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// Returns the CPU time that the pool's threads spent while the caller waited, milliseconds,
    /// since the last call.
    pub fn take_extra_ms(&self) -> f64 {
        self.extra_ns.swap(0, Ordering::Relaxed) as f64 * 1e-6
    }
}

/// Adds a worker's time when it finishes.
struct Busy<'a> {
    watch: Stopwatch,
    total: &'a AtomicU64,
}

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.total.fetch_add(self.watch.elapsed().as_nanos() as u64, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_number_of_workers_gives_the_same() {
        let input: Vec<u64> = (0..1000).collect();
        let (mut one, mut three) = (Vec::new(), Vec::new());
        Workers::new(1).map_into(&input, &mut one, |x| x * x % 977);
        Workers::new(3).map_into(&input, &mut three, |x| x * x % 977);
        assert_eq!(one, three);
        let mut items = input.clone();
        Workers::new(2).for_each(&mut items, |x| *x = *x * *x % 977);
        assert_eq!(items, one);
    }
}
