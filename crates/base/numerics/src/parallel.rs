//! Pieces of work on all cores of the computer, their results in order.

use rayon::prelude::*;

/// Returns what `of` makes of each of `items`, on all cores; on this core alone where the work is not worth
/// the threads.
pub fn parallel_map<T: Sync, R: Send>(
    items: &[T],
    is_worth: bool,
    of: impl Fn(&T) -> R + Send + Sync,
) -> Vec<R> {
    if is_worth { items.par_iter().map(of).collect() } else { items.iter().map(of).collect() }
}

/// Returns two pieces of work at once.
pub fn parallel_join<A: Send, B: Send>(
    one: impl FnOnce() -> A + Send,
    other: impl FnOnce() -> B + Send,
) -> (A, B) {
    rayon::join(one, other)
}

/// Returns what `of` gives with all its pieces on one core of the computer: for work whose parts are spread over the
/// cores already.
///
/// # Panics
/// No thread can be started.
pub fn run_single_threaded<R: Send>(of: impl FnOnce() -> R + Send) -> R {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    pool.expect("a thread can be started").install(of)
}
