//! A queue of bytes between a task that receives them and a lower one that reads them, without a lock.
//!
//! The writer publishes a batch at once. At 16 MHz a byte of the serial line has 173 cycles in all, so a queue that loads and
//! stores both of its ends for each byte takes too many of them (`cargo xtask bounds`, `serial_receive`).

use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering};

/// A queue of at most `N` bytes, a power of two.
///
/// ```
/// use trueup_link::byte_queue::ByteQueue;
/// let mut queue = ByteQueue::<4>::new();
/// let (mut writer, mut reader) = queue.split();
/// let mut batch = writer.begin_batch();
/// assert_eq!([1, 2, 3, 4, 5].map(|byte| batch.push(byte)), [true, true, true, true, false]);
/// drop(batch);
/// assert_eq!(reader.pop(), Some(1));
/// ```
#[derive(Debug)]
pub struct ByteQueue<const N: usize> {
    bytes: [AtomicU8; N],
    /// Bytes that were ever read and written; both wrap.
    read: AtomicUsize,
    written: AtomicUsize,
}

impl<const N: usize> ByteQueue<N> {
    /// Returns an empty queue.
    #[must_use]
    pub const fn new() -> Self {
        // The places go on where the counts wrap.
        const { assert!(N.is_power_of_two(), "the size of a queue of bytes is a power of two") };
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            read: AtomicUsize::new(0),
            written: AtomicUsize::new(0),
        }
    }

    /// Returns both ends.
    pub const fn split(&mut self) -> (Writer<'_, N>, Reader<'_, N>) {
        (Writer(self), Reader(self))
    }

    const fn slot(&self, count: usize) -> &AtomicU8 {
        // Never behind the end, and the compiler sees it.
        #[allow(clippy::indexing_slicing, reason = "N is a power of two")]
        &self.bytes[count & N.wrapping_sub(1)]
    }
}

impl<const N: usize> Default for ByteQueue<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The end that bytes are written to.
#[derive(Debug)]
pub struct Writer<'a, const N: usize>(&'a ByteQueue<N>);

impl<const N: usize> Writer<'_, N> {
    /// Begins a batch, which the reader sees when it is dropped.
    pub fn begin_batch(&mut self) -> Batch<'_, N> {
        let written = self.0.written.load(Ordering::Relaxed);
        let used = written.wrapping_sub(self.0.read.load(Ordering::Acquire));
        Batch { queue: self.0, written, room: N.saturating_sub(used) }
    }
}

/// Bytes that are written together.
#[derive(Debug)]
pub struct Batch<'a, const N: usize> {
    queue: &'a ByteQueue<N>,
    written: usize,
    room: usize,
}

impl<const N: usize> Batch<'_, N> {
    /// Adds a byte; `false`: the queue is full, and the byte is lost.
    #[inline]
    pub fn push(&mut self, byte: u8) -> bool {
        let Some(room) = self.room.checked_sub(1) else { return false };
        self.room = room;
        self.queue.slot(self.written).store(byte, Ordering::Relaxed);
        self.written = self.written.wrapping_add(1);
        true
    }
}

impl<const N: usize> Drop for Batch<'_, N> {
    fn drop(&mut self) {
        self.queue.written.store(self.written, Ordering::Release);
    }
}

/// The end that bytes are read from.
#[derive(Debug)]
pub struct Reader<'a, const N: usize>(&'a ByteQueue<N>);

impl<const N: usize> Reader<'_, N> {
    /// Takes the oldest byte.
    #[inline]
    pub fn pop(&mut self) -> Option<u8> {
        let read = self.0.read.load(Ordering::Relaxed);
        if read == self.0.written.load(Ordering::Acquire) {
            return None;
        }
        let byte = self.0.slot(read).load(Ordering::Relaxed);
        self.0.read.store(read.wrapping_add(1), Ordering::Release);
        Some(byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{collections::VecDeque, thread, vec::Vec};

    #[test]
    fn batches_come_out_as_they_went_in_and_what_has_no_room_is_lost() {
        let mut queue = ByteQueue::<8>::new();
        // Across the wrap of the counts as well.
        queue.read = AtomicUsize::new(usize::MAX - 20);
        queue.written = AtomicUsize::new(usize::MAX - 20);
        let (mut writer, mut reader) = queue.split();
        let (mut expected, mut next, mut lost) = (VecDeque::new(), 0_u8, 0);
        for turn in 0..400_usize {
            let mut batch = writer.begin_batch();
            for _ in 0..turn % 7 {
                next = next.wrapping_add(1);
                let has_room = expected.len() < 8;
                assert_eq!(batch.push(next), has_room);
                if has_room { expected.push_back(next) } else { lost += 1 }
            }
            drop(batch);
            for _ in 0..turn % 5 {
                assert_eq!(reader.pop(), expected.pop_front());
            }
        }
        assert!(lost > 100);
    }

    #[test]
    fn a_batch_is_seen_when_it_ends() {
        let mut queue = ByteQueue::<4>::new();
        let (mut writer, mut reader) = queue.split();
        let mut batch = writer.begin_batch();
        assert!(batch.push(1));
        assert_eq!(reader.pop(), None);
        drop(batch);
        assert_eq!([reader.pop(), reader.pop()], [Some(1), None]);
    }

    #[test]
    fn two_threads_lose_and_swap_nothing() {
        let mut queue = ByteQueue::<16>::new();
        let (mut writer, mut reader) = queue.split();
        let sent: Vec<u8> = (0..20_000_u32).map(|index| (index % 251) as u8).collect();
        let mut got = Vec::new();
        thread::scope(|scope| {
            scope.spawn(|| {
                let mut rest = sent.as_slice();
                while !rest.is_empty() {
                    let mut batch = writer.begin_batch();
                    while let Some((byte, others)) = rest.split_first()
                        && batch.push(*byte)
                    {
                        rest = others;
                    }
                    drop(batch);
                    thread::yield_now();
                }
            });
            while got.len() < sent.len() {
                match reader.pop() {
                    Some(byte) => got.push(byte),
                    None => thread::yield_now(),
                }
            }
        });
        assert_eq!(got, sent);
    }
}
