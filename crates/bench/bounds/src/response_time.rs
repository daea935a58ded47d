//! Response times under fixed priorities (Joseph and Pandya 1986; Audsley and others 1993), with the immediate ceilings of
//! RTIC and critical sections as blocking.
//!
//! ```text
//! R = C + S + B + W(bytes in R) + Σ over tasks of the same or a higher priority (starts in R) · (C₀ + S) + W(bytes in R)
//! W(n) = n · c + ⌈n / l⌉ · e
//! ```
//!
//! A byte costs c, and e more where it ends a line, which has l bytes at the least.
//!
//! A task of the same priority does not interrupt, but may come first: it counts as a higher one. B is the longest section
//! of a task below whose ceiling reaches the task, once: with immediate ceilings no job waits for two. A task whose
//! interrupt software raises may have one start more in a window, for it is raised late. Where R is longer than the
//! period, a start waits for the turn before, and its C counts twice: interrupts that are pending do not add up. A task that
//! bytes start has all turns of its busy period in place of that, and each byte once.

use crate::clock_configuration::{ClockConfiguration, FLASH_CACHE_LINES};

/// What the core spends beyond the tasks' own instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CoreOverhead {
    /// Cycles of an entry and a return.
    pub switch: u64,
    /// Cycles in which a section that holds a task off reads the lines again that the cache may have lost before it.
    pub refill: u64,
    /// Share of the cycles that the DMA takes at the memories, in thousandths.
    pub dma_per_mille: u64,
}

impl CoreOverhead {
    /// Returns it for a clock.
    ///
    /// An entry and a return take 12 cycles each (DDI 0439, exception model), the registers of the FPU that are saved and
    /// restored at first use 17 words each way, the refill 3, three lines of the flash (the vector, the handler, the way
    /// back) their wait states, a round of an exclusive store that it has made fail 20, all lines of the cache that
    /// the interrupted task may have lost. The DMA moves 20 codes and 92 bytes
    /// each way in a millisecond, five cycles each.
    #[must_use]
    pub(crate) fn for_clock(clock: &ClockConfiguration) -> Self {
        let lines = 3 * u64::from(clock.flash);
        let refill = FLASH_CACHE_LINES as u64 * u64::from(clock.flash);
        let moved = (20 + 2 * 92) * 5;
        Self {
            switch: 12 + 12 + 2 * 18 + 3 + 20 + lines + refill,
            refill,
            dma_per_mille: moved / u64::from(clock.mhz) + 1,
        }
    }
}

/// A task in cycles.
#[derive(Clone, Debug)]
pub(crate) struct TaskLoad {
    /// Its name, or that of a function that counts as one.
    pub name: String,
    /// Its priority.
    pub priority: u8,
    /// Cycles between two starts, at the least.
    pub period: u64,
    /// Starts that may come at once in addition to those of the period.
    pub burst: u64,
    /// Cycles by which a start may be older than the window that it counts in.
    pub jitter: u64,
    /// Cycles of a turn that finds no byte.
    pub empty: u64,
    /// Cycles of each byte that it finds.
    pub each: u64,
    /// Cycles of the end of a line, in addition.
    pub line_end: u64,
    /// Bytes of a line, at the least.
    pub line: u64,
    /// Cycles between two bytes.
    pub gap: u64,
    /// Bytes that may wait.
    pub waiting: u64,
    /// Cycles for which a task below may hold it off.
    pub blocking: u64,
}

impl TaskLoad {
    /// Returns the cycles of its longest turn.
    #[must_use]
    pub(crate) fn worst_case_cycles(&self) -> u64 {
        self.empty + self.byte_cycles(self.waiting)
    }

    /// Returns the cycles of bytes that come one after the other.
    fn byte_cycles(&self, bytes: u64) -> u64 {
        bytes * self.each + bytes.div_ceil(self.line.max(1)) * self.line_end
    }

    /// Returns the share of the time that it may take in the long run.
    #[must_use]
    pub(crate) fn utilisation(&self, core: CoreOverhead) -> f64 {
        let period = self.period as f64;
        let bytes = if self.gap == 0 { 0.0 } else { 1.0 / self.gap as f64 };
        let bytes = bytes.min(self.waiting as f64 / period);
        let each = self.each as f64 + self.line_end as f64 / self.line.max(1) as f64;
        (self.empty + core.switch) as f64 / period + bytes * each
    }

    /// Cycles that it may take within a window.
    fn demand_cycles(&self, window: u64, switch: u64) -> u64 {
        let starts = (window + self.jitter).div_ceil(self.period) + self.burst;
        let bytes = window.checked_div(self.gap).map_or(0, |bytes| bytes + 1 + self.waiting);
        let bytes = bytes.min(starts * self.waiting);
        starts * (self.empty + switch) + self.byte_cycles(bytes)
    }
}

/// Returns the share of the time that a task and all of its priority and above may take in the long run. From 1 on no response
/// below is bounded, however late it may be.
#[must_use]
pub(crate) fn utilisation(tasks: &[TaskLoad], number: usize, core: CoreOverhead) -> f64 {
    let above = tasks.iter().filter(|task| task.priority >= tasks[number].priority);
    above.map(|task| task.utilisation(core)).sum::<f64>()
        * (1.0 + core.dma_per_mille as f64 / 1_000.0)
}

/// Returns the longest response of a task in cycles; `None`: it is longer than `limit`.
#[must_use]
pub(crate) fn worst_case_response_cycles(
    tasks: &[TaskLoad],
    number: usize,
    core: CoreOverhead,
    limit: u64,
) -> Option<u64> {
    let CoreOverhead { switch, refill, dma_per_mille } = core;
    let own = &tasks[number];
    let blocking = if own.blocking > 0 { own.blocking + refill } else { 0 };
    let mut response = own.worst_case_cycles() + switch + blocking;
    loop {
        let others = tasks
            .iter()
            .enumerate()
            .filter(|(other, task)| *other != number && task.priority >= own.priority);
        let above: u64 = others.map(|(_, task)| task.demand_cycles(response, switch)).sum();
        // Bytes that come meanwhile are taken in the same turn.
        let came = response.checked_div(own.gap).map_or(0, |bytes| bytes + 1);
        let turn = own.empty + own.byte_cycles(own.waiting + came) + switch;
        let again = if response > own.period { turn } else { 0 };
        // Where bytes start the task, they count once in however many turns: the response ends with the busy period at the latest.
        let turns = if own.waiting > 0 {
            own.demand_cycles(response, switch).max(turn)
        } else {
            turn + again
        };
        let sum = turns + blocking + above;
        let next = sum + sum * dma_per_mille / 1_000;
        if next > limit {
            return None;
        }
        if next <= response {
            return Some(response);
        }
        response = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task(priority: u8, period: u64, cycles: u64, blocking: u64) -> TaskLoad {
        TaskLoad {
            name: String::new(),
            priority,
            period,
            burst: 0,
            jitter: 0,
            empty: cycles,
            each: 0,
            line_end: 0,
            line: 1,
            gap: 0,
            waiting: 0,
            blocking,
        }
    }

    const IDEAL: CoreOverhead = CoreOverhead { switch: 0, refill: 0, dma_per_mille: 0 };

    #[test]
    fn the_lowest_of_three_waits_for_all_starts_above() {
        // 3 of 7, 3 of 12, 5 of 20: the set of Burns and Wellings, whose responses are 3, 6 and 20.
        let tasks = [task(3, 7, 3, 0), task(2, 12, 3, 0), task(1, 20, 5, 0)];
        let of = |number, limit| worst_case_response_cycles(&tasks, number, IDEAL, limit);
        assert_eq!([of(0, 7), of(1, 12), of(2, 20)], [Some(3), Some(6), Some(20)]);
        assert_eq!(of(2, 19), None);
        // A section of a lower task, the DMA, and each switch come on top.
        let held = [task(3, 7_000, 3_000, 500), task(2, 12_000, 3_000, 0)];
        assert_eq!(worst_case_response_cycles(&held, 0, IDEAL, 7_000), Some(3_500));
        assert_eq!(
            worst_case_response_cycles(
                &held,
                1,
                CoreOverhead { switch: 10, refill: 0, dma_per_mille: 100 },
                9_000
            ),
            Some(6_622)
        );
    }

    #[test]
    fn the_response_of_a_task_that_bytes_start_ends_with_its_busy_period() {
        let line = TaskLoad { gap: 100, waiting: 4, each: 10, ..task(1, 50, 1, 0) };
        // Two starts, the four bytes that waited and one that came: not the same bytes in the turn before as well.
        let alone = [line.clone()];
        assert_eq!(worst_case_response_cycles(&alone, 0, IDEAL, 1_000), Some(2 + 5 * 10));
        let both = [task(2, 100, 30, 0), line];
        assert_eq!(worst_case_response_cycles(&both, 1, IDEAL, 1_000), Some(30 + 2 + 5 * 10));
    }

    #[test]
    fn bytes_count_once_however_often_their_task_starts() {
        let line = TaskLoad { gap: 100, waiting: 4, each: 10, ..task(2, 50, 1, 0) };
        // 200 cycles: four starts, and 4 bytes that waited with three that came.
        assert_eq!(line.demand_cycles(200, 0), 4 + 7 * 10);
        assert_eq!(line.worst_case_cycles(), 41);
        // A start in 50 cycles, a byte in 100; where no more than the bytes of a start can wait, these.
        assert_eq!(line.utilisation(IDEAL), 1.0 / 50.0 + 10.0 / 100.0);
        // A line of three ends once in three bytes, and may end with the first of them: seven bytes have three ends.
        let lines = TaskLoad { line_end: 7, line: 3, ..line.clone() };
        assert_eq!(
            (lines.demand_cycles(200, 0), lines.worst_case_cycles()),
            (4 + 7 * 10 + 3 * 7, 41 + 2 * 7)
        );
        assert!((lines.utilisation(IDEAL) - (0.02 + (10.0 + 7.0 / 3.0) / 100.0)).abs() < 1e-12);
        // A start that may come at once with another one.
        assert_eq!(
            TaskLoad { burst: 1, ..lines.clone() }.demand_cycles(200, 0),
            5 + 7 * 10 + 3 * 7
        );
        // One that has begun before.
        assert_eq!(TaskLoad { jitter: 1, ..lines }.demand_cycles(200, 0), 5 + 7 * 10 + 3 * 7);
        let seldom = TaskLoad { period: 1_000, ..line.clone() };
        assert_eq!(seldom.utilisation(IDEAL), 1.0 / 1_000.0 + 4.0 * 10.0 / 1_000.0);
        // Those below do not count.
        let tasks = [task(3, 10, 2, 0), task(2, 10, 3, 0), task(2, 10, 1, 0)];
        let of = |number| utilisation(&tasks, number, IDEAL);
        assert!((of(0) - 0.2).abs() < 1e-12 && (of(1) - 0.6).abs() < 1e-12);
    }
}
