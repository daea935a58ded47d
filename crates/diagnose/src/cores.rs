//! Work of equal pieces on all cores of the computer, in order.

use std::thread;

/// What `of` makes of each of `items`, each core a part of them; on this core alone where it is not
/// worth the threads.
pub(crate) fn on_all_cores<T: Sync, R: Send>(
    items: &[T],
    is_worth: bool,
    of: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    if !is_worth || cores == 1 || items.len() < 2 {
        return items.iter().map(of).collect();
    }
    let part = items.len().div_ceil(cores);
    let of = &of;
    thread::scope(|scope| {
        let workers: Vec<_> = items
            .chunks(part)
            .map(|items| scope.spawn(move || items.iter().map(of).collect::<Vec<R>>()))
            .collect();
        workers
            .into_iter()
            .flat_map(|worker| worker.join().expect("arithmetic does not panic"))
            .collect()
    })
}
