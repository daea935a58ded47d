//! The bounds of all tasks on all clocks, and as a table.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use anyhow::{Context as _, Result};

use crate::{
    clock_configuration::{CLOCK_CONFIGURATIONS, ClockConfiguration},
    critical_sections::{CriticalSection, CriticalSectionAnalysis},
    declarations::{CalibrationSizes, DeclarationTable},
    flow_facts::MAX_FLASH_PROGRAM_STALL_US,
    function_entry::FunctionEntry,
    image::FirmwareImage,
    program::Program,
    response_time::{self, CoreOverhead, TaskLoad},
    source_code::SourceCode,
    tasks::{self, ByteArrivals, Task},
    wcet::WcetAnalysis,
};

/// The bounds of a task on a clock, in microseconds.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskBounds {
    /// Its name.
    pub task: String,
    /// The clock's name.
    pub clock: &'static str,
    /// The number of its exception.
    pub exception: u32,
    /// Its priority.
    pub priority: u8,
    /// The longest turn, if nothing interrupts it.
    pub turn_us: f64,
    /// The longest that a task below holds it off.
    pub blocking_us: f64,
    /// The share of the time that it may take in the long run, with all tasks of its priority and above. From 1 on
    /// nothing bounds its response.
    pub share: f64,
    /// From its start to its end at the longest; `None`: longer than the deadline.
    pub response_us: Option<f64>,
    /// The same while a word of the flash is programmed, which no task interrupts.
    pub stalled_us: Option<f64>,
    /// Its deadline.
    pub deadline_us: f64,
}

/// All bounds, and what is missing for them.
#[derive(Clone, Debug, Default)]
pub struct TimingBounds {
    /// A bound of each task on each clock.
    pub all: Vec<TaskBounds>,
    /// Loops without a bound and calls without a target: with one of them nothing is bounded.
    pub problems: Vec<String>,
    /// Declarations that nothing needed.
    pub unused: Vec<String>,
    /// How many loops the code bounds, and how many the table.
    pub loops: [usize; 2],
    /// The load of each task alone, and of each function that counts as one.
    pub shares: Vec<LoadShare>,
}

/// The load of a task, or of a function that counts as one.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadShare {
    /// The clock's name.
    pub clock: &'static str,
    /// Its name.
    pub name: String,
    /// Its priority.
    pub priority: u8,
    /// Microseconds of a turn without bytes, or of a call.
    pub empty_us: f64,
    /// The share of the time that it may take in the long run.
    pub share: f64,
}

/// Computes the bounds of the tasks of an app (the text of `src/main.rs`) in an image, for calibrations of these sizes.
///
/// # Errors
/// The app's table cannot be read, or a task has no function in the image.
pub fn compute_timing_bounds(
    image: &FirmwareImage,
    app: &str,
    table: &DeclarationTable,
    source: &SourceCode,
    sizes: CalibrationSizes,
) -> Result<TimingBounds> {
    let program = Program::new(image, table, source, sizes);
    let all_tasks = tasks::parse_tasks(app)?;
    let functions = all_tasks.iter().filter_map(|task| image.function_by_symbol(&task.interrupt));
    let entries = functions.map(|function| FunctionEntry::new(function.start));
    program.determine_ram_arguments(&entries.collect::<Vec<_>>());
    let (mut all, mut shares) = (Vec::new(), Vec::new());
    for clock in CLOCK_CONFIGURATIONS {
        let tasks: Vec<Task> =
            all_tasks.iter().filter(|task| task.is_active_at(clock.mhz)).cloned().collect();
        let exceptions = exception_numbers(image, &tasks)?;
        let (loads, turns) = compute_task_loads(&program, image, &tasks, clock)?;
        shares.extend(loads.iter().map(|load| LoadShare {
            clock: clock.name,
            name: load.name.clone(),
            priority: load.priority,
            empty_us: load.empty as f64 / f64::from(clock.mhz),
            share: load.utilisation(CoreOverhead::for_clock(&clock)),
        }));
        all.extend(tasks.iter().enumerate().map(|(number, task)| {
            let deadline_us = task.deadline_us(clock.mhz);
            let cycles = |us: f64| (us * f64::from(clock.mhz)) as u64;
            let us = |cycles: u64| cycles as f64 / f64::from(clock.mhz);
            let longest = |loads: &[TaskLoad]| {
                response_time::worst_case_response_cycles(
                    loads,
                    number,
                    CoreOverhead::for_clock(&clock),
                    cycles(deadline_us),
                )
                .map(us)
            };
            let mut stalled = loads.clone();
            stalled[number].blocking =
                stalled[number].blocking.max(cycles(MAX_FLASH_PROGRAM_STALL_US));
            TaskBounds {
                task: task.name.clone(),
                clock: clock.name,
                exception: exceptions[number],
                priority: task.priority,
                turn_us: us(turns[number]),
                blocking_us: us(loads[number].blocking),
                share: response_time::utilisation(&loads, number, CoreOverhead::for_clock(&clock)),
                response_us: longest(&loads),
                stalled_us: longest(&stalled),
                deadline_us,
            }
        }));
    }
    let loops = program.loop_counts_by_bound_origin();
    Ok(TimingBounds {
        all,
        problems: program.missing_flow_facts(),
        unused: program.unused_declarations(),
        loops,
        shares,
    })
}

/// The numbers of the tasks' exceptions.
fn exception_numbers(image: &FirmwareImage, tasks: &[Task]) -> Result<Vec<u32>> {
    let number = |task: &Task| {
        let function = image.function_by_symbol(&task.interrupt);
        let number = function.and_then(|function| image.exception_number(function.start));
        number.with_context(|| format!("no vector leads to {}", task.interrupt))
    };
    tasks.iter().map(number).collect()
}

/// Functions that share a rate, as a load.
struct SharedRateLoad {
    load: TaskLoad,
    /// Their addresses.
    starts: BTreeSet<u32>,
}

/// The tasks in cycles on a clock, and behind them the functions that are called once in a while, as tasks of their own;
/// the longest turn of each task.
fn compute_task_loads(
    program: &Program<'_>,
    image: &FirmwareImage,
    tasks: &[Task],
    clock: ClockConfiguration,
) -> Result<(Vec<TaskLoad>, Vec<u64>)> {
    let for_bytes_within_line = program.for_bytes_within_line();
    let cycles = |us: f64| (us * f64::from(clock.mhz)) as u64;
    let (mut entries, mut loads, mut turns) = (Vec::new(), Vec::new(), Vec::new());
    // By the declaration: functions of the same one share its rate.
    let mut seldom: BTreeMap<&'static str, SharedRateLoad> = BTreeMap::new();
    let mut sections: BTreeMap<(FunctionEntry, BTreeSet<u32>), Vec<CriticalSection>> =
        BTreeMap::new();
    let rates = program.rate_limited_functions();
    for task in tasks {
        let function = image.function_by_symbol(&task.interrupt);
        let function = function.with_context(|| {
            format!("{}: the image has no function {}", task.name, task.interrupt)
        })?;
        let entry = FunctionEntry::new(function.start);
        let waiting = task.bytes.map(|bytes| bytes.waiting);
        let (whole, once) = WcetAnalysis::compute_task_wcet(program, clock, waiting, entry);
        let costs = task.bytes.map(|bytes| {
            compute_byte_costs([&for_bytes_within_line, program], clock, bytes, entry)
        });
        let costs = costs.unwrap_or(ByteCosts { empty: whole, each: 0, line_end: 0 });
        let ByteCosts { empty, each, line_end } = costs;
        entries.push((entry, waiting));
        let load = TaskLoad {
            name: task.name.clone(),
            priority: task.priority,
            period: cycles(task.period_us(clock.mhz)).max(1),
            burst: u64::from(task.is_raised),
            jitter: 0,
            empty,
            each,
            line_end,
            line: task.bytes.map_or(1, |bytes| bytes.line.into()),
            gap: task.bytes.map_or(0, |bytes| cycles(bytes.gap_us)),
            waiting: u64::from(waiting.unwrap_or_default()),
            blocking: 0,
        };
        // All that may come at once may do so in one turn.
        let in_a_turn =
            once.iter().map(|(start, (_, cost))| cost * u64::from(1 + rates[start].burst));
        turns.push(load.worst_case_cycles() + in_a_turn.sum::<u64>());
        for (start, (_, cost)) in once {
            let once = &rates[&start];
            let (period, burst) = (cycles(once.period_us), once.burst.into());
            let bytes = TaskLoad { gap: 0, waiting: 0, each: 0, line_end: 0, ..load.clone() };
            let name =
                image.function_at(start).map_or_else(String::new, |function| function.name.clone());
            let own = TaskLoad { name, period, burst, empty: cost, ..bytes };
            let known = seldom
                .entry(once.function)
                .or_insert_with(|| SharedRateLoad { load: own.clone(), starts: BTreeSet::new() });
            known.starts.insert(start);
            if cost > known.load.empty {
                (known.load.empty, known.load.name) = (cost, own.name);
            }
            known.load.priority = known.load.priority.max(task.priority);
        }
        loads.push(load);
    }
    let mut below =
        |tasks: &[(FunctionEntry, Option<u32>)], free: &BTreeSet<u32>| -> Vec<CriticalSection> {
            let all = tasks.iter().flat_map(|(entry, waiting)| {
                let known = sections.entry((*entry, free.clone())).or_insert_with(|| {
                    let worst = WcetAnalysis::new(program, clock, *waiting)
                        .with_zero_cost_functions(free.clone());
                    CriticalSectionAnalysis::new(program, &worst)
                        .find_critical_sections_in_call_tree(*entry)
                });
                known.clone()
            });
            all.collect()
        };
    let whole = below(&entries, &BTreeSet::new());
    // A call that holds a task off may have begun before it, by twice the longest section where tasks above interrupt it: those
    // of this time count as well.
    let begun = 2 * whole.iter().map(|section| section.cycles).max().unwrap_or(0);
    for rated in seldom.values_mut() {
        rated.load.jitter = begun;
    }
    for (number, task) in tasks.iter().enumerate() {
        // What is a load of its own at this priority or above delays the task as such, wherever it is called.
        let counted = seldom.values().filter(|rated| rated.load.priority >= task.priority);
        let counted: BTreeSet<u32> = counted.flat_map(|rated| rated.starts.clone()).collect();
        let lower = tasks.iter().zip(&entries).filter(|(other, _)| other.priority < task.priority);
        let lower: Vec<_> = lower.map(|(_, entry)| *entry).collect();
        let reaching = below(&lower, &counted).into_iter();
        let reaching = reaching
            .filter(|section| section.ceiling.is_none_or(|ceiling| ceiling >= task.priority));
        loads[number].blocking = reaching.map(|section| section.cycles).max().unwrap_or(0);
    }
    loads.extend(seldom.into_values().map(|rated| rated.load));
    Ok((loads, turns))
}

/// What a turn takes by the bytes that it finds, in cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ByteCosts {
    /// Without a byte, and what the first bytes take in addition to `each`.
    empty: u64,
    each: u64,
    /// A byte that ends a line, in addition.
    line_end: u64,
}

/// Returns the costs of a task by the bytes that it finds; `programs`: where no byte ends a line, and where each does.
fn compute_byte_costs(
    programs: [&Program<'_>; 2],
    clock: ClockConfiguration,
    bytes: ByteArrivals,
    entry: FunctionEntry,
) -> ByteCosts {
    let [within, ending] = programs.map(|program| -> Vec<u64> {
        let of =
            |count| WcetAnalysis::cycles_without_once_calls(program, clock, Some(count), entry);
        (0..=bytes.waiting).map(of).collect()
    });
    // Where there are no lines, each byte is as any other.
    if bytes.line > 1 { ByteCosts::new(&within, &ending) } else { ByteCosts::new(&ending, &[]) }
}

impl ByteCosts {
    /// Returns the costs of a task whose turn takes `within[n]` cycles for n bytes none of which ends a line, and `ending[n]` where
    /// each does, empty where there are no lines: no turn takes more than they say.
    ///
    /// The first bytes may take longer than the mean, because the cache takes the loop with them; and again behind each byte that
    /// ends a line, for what that runs may take the loop from the cache.
    fn new(within: &[u64], ending: &[u64]) -> Self {
        let without = within.first().copied().unwrap_or(0);
        let count = (within.len() as u64).saturating_sub(1).max(1);
        let each = within.last().map_or(0, |last| last.saturating_sub(without)).div_ceil(count);
        let beyond = within
            .iter()
            .zip(0..)
            .map(|(cycles, count)| cycles.saturating_sub(without).saturating_sub(each * count));
        let first = beyond.max().unwrap_or(0);
        let steps = ending.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
        let line_end = steps.max().map_or(0, |longest| longest.saturating_sub(each) + first);
        let empty = without.max(ending.first().copied().unwrap_or(0)) + first;
        Self { empty, each, line_end }
    }
}

impl TimingBounds {
    /// Returns the tasks whose response is not bounded below their deadline, as `clock task`.
    #[must_use]
    pub fn unschedulable_tasks(&self) -> Vec<String> {
        let late = self.all.iter().filter(|bound| bound.response_us.is_none());
        late.map(|bound| format!("{} {}", bound.clock, bound.task)).collect()
    }

    /// Returns the table; `seen` gives the longest turn of a task on a clock that was seen, of its own and from beginning to
    /// end, in microseconds.
    #[must_use]
    pub fn format_table(&self, seen: impl Fn(&TaskBounds) -> Option<[f64; 2]>) -> String {
        let mut text = String::new();
        let [code, table] = self.loops;
        writeln!(text, "{code} loops are bounded by the code, {table} by the table").ok();
        for clock in CLOCK_CONFIGURATIONS {
            writeln!(text, "\n{}, {} wait states; in µs", clock.name, clock.flash).ok();
            writeln!(
                text,
                "{:<16} {:>4} {:>10} {:>9} {:>6} {:>10} {:>6} {:>10} {:>10} {:>10}",
                "task",
                "prio",
                "turn",
                "seen",
                "times",
                "blocked",
                "load",
                "response",
                "stalled",
                "deadline"
            )
            .ok();
            for bound in self.all.iter().filter(|bound| bound.clock == clock.name) {
                let seen = seen(bound);
                let times = seen.map(|[own, _]| format!("{:.1}", bound.turn_us / own));
                let seen = seen.map(|[own, _]| format!("{own:.1}"));
                let or_late = |value: Option<f64>| {
                    value.map_or_else(
                        || "not below".to_owned(),
                        |microseconds| format!("{microseconds:.1}"),
                    )
                };
                writeln!(
                    text,
                    "{:<16} {:>4} {:>10.1} {:>9} {:>6} {:>10.1} {:>5.0}% {:>10} {:>10} {:>10.1}",
                    bound.task,
                    bound.priority,
                    bound.turn_us,
                    seen.as_deref().unwrap_or("–"),
                    times.as_deref().unwrap_or("–"),
                    bound.blocking_us,
                    100.0 * bound.share,
                    or_late(bound.response_us),
                    or_late(bound.stalled_us),
                    bound.deadline_us,
                )
                .ok();
            }
            writeln!(text, "\nload of its own, by priority").ok();
            let mut own: Vec<_> =
                self.shares.iter().filter(|share| share.clock == clock.name).collect();
            own.sort_by_key(|share| std::cmp::Reverse(share.priority));
            for it in own {
                let share = 100.0 * it.share;
                writeln!(
                    text,
                    "{:>4} {share:>7.1}% {:>10.1}  {}",
                    it.priority, it.empty_us, it.name
                )
                .ok();
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bytes_of_a_turn_and_those_behind_a_line_take_what_they_need() {
        // A loop of 10 cycles a round, which the cache takes in 30, or of 20 a round without: the longest is the lower of both.
        let within: Vec<u64> =
            (0..=20).map(|count| 5 + (20 * count).min(30 + 10 * count)).collect();
        let ending: Vec<u64> = (0..=20).map(|count| 5 + 90 * count).collect();
        let costs = ByteCosts::new(&within, &ending);
        // 230 cycles for 20 bytes are 12 each, and three bytes take 24 more than that.
        assert_eq!(costs, ByteCosts { empty: 5 + 24, each: 12, line_end: 90 - 12 + 24 });
        for (count, cycles) in (0..).zip(&within) {
            assert!(costs.empty + count * costs.each >= *cycles);
        }
        for (count, cycles) in (0..).zip(&ending) {
            assert!(costs.empty + count * (costs.each + costs.line_end) >= *cycles);
        }
    }
}
