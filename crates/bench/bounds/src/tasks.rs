//! The tasks as `src/main.rs` declares them: interrupt and priority in the attributes of RTIC, arrivals and deadline in the
//! table on top.
//!
//! A row of the table: `| task | trigger | priority | arrives | deadline | …`. The columns are found by their heads. A cell
//! has a time, and others for single clocks: `95 µs; at 16 MHz 573 µs`, or `at 16 MHz never`. `arrives` says how often a task starts at the
//! most, and which bytes it finds: `0.24 ms; 256 bytes, 10.8 µs each`.

use std::collections::BTreeMap;

use anyhow::{Context as _, Result, ensure};

/// A task.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Task {
    /// Its name.
    pub name: String,
    /// The interrupt that starts it, which is the name of its function in the image.
    pub interrupt: String,
    /// Its priority; a higher one interrupts a lower one.
    pub priority: u8,
    /// Software raises its interrupt.
    pub is_raised: bool,
    /// Bytes that it takes one by one.
    pub bytes: Option<ByteArrivals>,
    /// Microseconds between two starts, at the least, by clock where that differs.
    periods_us: BTreeMap<Option<u32>, f64>,
    /// Microseconds until it has to be over, by clock where that differs.
    deadlines_us: BTreeMap<Option<u32>, f64>,
}

/// Bytes that come to a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ByteArrivals {
    /// Microseconds between two.
    pub gap_us: f64,
    /// How many may wait.
    pub waiting: u32,
    /// How many a line has at the least; 1: each may end one.
    pub line: u32,
}

impl Task {
    /// Returns whether anything starts it at a clock of that many MHz.
    #[must_use]
    pub(crate) fn is_active_at(&self, mhz: u32) -> bool {
        self.periods_us.get(&Some(mhz)) != Some(&f64::INFINITY)
    }

    /// Returns the time between two starts at a clock of that many MHz, in microseconds.
    #[must_use]
    pub fn period_us(&self, mhz: u32) -> f64 {
        let own = self.periods_us.get(&Some(mhz));
        *own.or(self.periods_us.get(&None)).expect("each row has one")
    }

    /// Returns the deadline at a clock of that many MHz, in microseconds.
    #[must_use]
    pub(crate) fn deadline_us(&self, mhz: u32) -> f64 {
        let own = self.deadlines_us.get(&Some(mhz));
        *own.or(self.deadlines_us.get(&None)).expect("each row has one")
    }
}

/// Reads the tasks of an app.
///
/// # Errors
/// A task has no row in the table, a row no deadline, or attribute and row differ in priority.
pub(crate) fn parse_tasks(text: &str) -> Result<Vec<Task>> {
    let rows = parse_task_rows(text)?;
    let mut tasks = Vec::new();
    let mut rest = text;
    while let Some((_, after)) = rest.split_once("#[task(") {
        let (attribute, body) = after.split_once(")]").context("an attribute has no end")?;
        rest = body;
        let value = |key: &str| {
            let (_, value) = attribute.split_once(key)?;
            let value = value.trim_start().strip_prefix('=')?.trim_start();
            let end = value.find(|letter: char| !letter.is_alphanumeric() && letter != '_');
            Some(&value[..end.unwrap_or(value.len())])
        };
        let interrupt = value("binds").context("a task binds no interrupt")?.to_owned();
        let priority = value("priority").with_context(|| format!("{interrupt}: no priority"))?;
        let priority: u8 = priority.parse()?;
        let name = body.split_once("fn ").and_then(|(_, rest)| rest.split_once('('));
        let name = name.with_context(|| format!("{interrupt}: no function"))?.0.to_owned();
        let row = rows.get(&name).with_context(|| {
            format!("task {name} has no row in the table on top of src/main.rs: add one")
        })?;
        let stated: u8 = row.priority.parse().with_context(|| format!("priority of {name}"))?;
        ensure!(stated == priority, "{name}: the table says priority {stated}, RTIC {priority}");
        tasks.push(Task {
            priority,
            is_raised: text.contains(&format!("Interrupt::{interrupt}")),
            bytes: parse_byte_arrivals(&row.arrives),
            periods_us: parse_values_per_clock(&row.arrives).with_context(|| {
                format!("{name}: `{}` has no time in the column `arrives`", row.arrives)
            })?,
            deadlines_us: parse_values_per_clock(&row.deadline).with_context(|| {
                format!("{name}: `{}` has no time in the column `deadline`", row.deadline)
            })?,
            name,
            interrupt,
        });
    }
    ensure!(!tasks.is_empty(), "no tasks were found");
    Ok(tasks)
}

#[derive(Clone, Debug)]
struct TaskRow {
    priority: String,
    deadline: String,
    arrives: String,
}

fn parse_task_rows(text: &str) -> Result<BTreeMap<String, TaskRow>> {
    let lines = text.lines().filter_map(|line| line.strip_prefix("//! |"));
    let mut cells = lines.map(|line| {
        let line = line.trim_end().strip_suffix('|').unwrap_or(line);
        line.split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>()
    });
    let head = cells.find(|head| head.first().is_some_and(|word| word == "task"));
    let head = head.context("src/main.rs has no table of tasks")?;
    let column = |name: &str| {
        let place = head.iter().position(|cell| cell == name);
        place.with_context(|| format!("the table of tasks has no column `{name}`"))
    };
    let (priority, deadline, arrives) =
        (column("priority")?, column("deadline")?, column("arrives")?);
    let mut rows: BTreeMap<String, TaskRow> = BTreeMap::new();
    let mut last: Option<TaskRow> = None;
    for cells in cells {
        let Some(names) = cells.first().filter(|name| name.starts_with('`')) else { continue };
        let cell = |column: usize| cells.get(column).cloned().unwrap_or_default();
        let mut row =
            TaskRow { priority: cell(priority), deadline: cell(deadline), arrives: cell(arrives) };
        if let Some(last) = &last {
            if row.deadline == "the same" {
                row.deadline.clone_from(&last.deadline);
            }
            if row.arrives == "the same" {
                row.arrives.clone_from(&last.arrives);
            }
        }
        last = Some(row.clone());
        let mut first = String::new();
        for name in names.split(", ") {
            let name = name.trim_matches('`');
            // `can_receive_0`, `_1`: the second one differs in its end.
            let whole = if name.starts_with('_') {
                format!(
                    "{}{name}",
                    first.trim_end_matches(
                        |character: char| character.is_ascii_digit() || character == '_'
                    )
                )
            } else {
                name.to_owned()
            };
            first.clone_from(&whole);
            rows.insert(whole, row.clone());
        }
    }
    Ok(rows)
}

/// `95 µs, the next byte; at 16 MHz 573 µs`.
fn parse_values_per_clock(cell: &str) -> Option<BTreeMap<Option<u32>, f64>> {
    let mut all = BTreeMap::new();
    for part in cell.split("; ").filter(|part| !part.contains(" bytes,")) {
        match part.strip_prefix("at ").and_then(|rest| rest.split_once(" MHz ")) {
            // Its unit is off at that clock.
            Some((mhz, "never")) => all.insert(Some(mhz.parse().ok()?), f64::INFINITY),
            Some((mhz, rest)) => all.insert(Some(mhz.parse().ok()?), parse_duration_us(rest)?),
            // Counted once.
            None if part.starts_with("never") => all.insert(None, f64::INFINITY),
            None => all.insert(None, parse_duration_us(part)?),
        };
    }
    all.contains_key(&None).then_some(all)
}

/// `256 bytes, 10.8 µs each, 22 a line`.
fn parse_byte_arrivals(cell: &str) -> Option<ByteArrivals> {
    let (waiting, gap) = cell.split("; ").find_map(|part| part.split_once(" bytes, "))?;
    let line = gap.split_once(", ").and_then(|(_, line)| line.split_once(" a line"));
    let line = line.map_or(Some(1), |(line, _)| line.parse().ok())?;
    Some(ByteArrivals { gap_us: parse_duration_us(gap)?, waiting: waiting.parse().ok()?, line })
}

/// The first number with a unit of time.
fn parse_duration_us(text: &str) -> Option<f64> {
    let words: Vec<&str> = text
        .split(|character: char| character.is_whitespace() || "(),;:".contains(character))
        .collect();
    words.windows(2).find_map(|pair| {
        let factor = match pair[1] {
            "µs" => 1.0,
            "ms" => 1_000.0,
            "s" => 1_000_000.0,
            _ => return None,
        };
        Some(pair[0].parse::<f64>().ok()? * factor)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const APP: &str = "//! | task | trigger | priority | arrives | deadline |\n//! |---|---|---|---|---|\n\
        //! | `fast` | a byte | 5 | 95 µs | 95 µs, the next; at 16 MHz 573 µs, slower |\n\
        //! | `can_0`, `_1` | a frame | 3 | 0.1 ms; at 16 MHz never; 3 bytes, 10 µs each | 256 bytes (2.8 ms) |\n\
        #[task(binds = USART3, priority = 5, local = [a])]\nfn fast(cx: fast::Context) {}\n\
        #[task(binds = CAN1_RX1, priority = 3)]\nfn can_1(cx: can_1::Context) {}\n";

    #[test]
    fn tasks_come_from_attributes_and_table() {
        let tasks = parse_tasks(APP).unwrap();
        assert_eq!(tasks.len(), 2);
        assert_eq!((tasks[0].name.as_str(), tasks[0].interrupt.as_str()), ("fast", "USART3"));
        assert_eq!((tasks[0].deadline_us(168), tasks[0].deadline_us(16)), (95.0, 573.0));
        assert_eq!((tasks[1].name.as_str(), tasks[1].priority), ("can_1", 3));
        assert_eq!((tasks[1].period_us(168), tasks[1].deadline_us(16)), (100.0, 2_800.0));
        assert_eq!(
            [168, 16].map(|mhz| [tasks[0].is_active_at(mhz), tasks[1].is_active_at(mhz)]),
            [[true; 2], [true, false]]
        );
        assert_eq!(tasks[1].bytes, Some(ByteArrivals { gap_us: 10.0, waiting: 3, line: 1 }));
        assert!(!tasks[1].is_raised);
    }

    #[test]
    fn a_task_without_a_row_or_with_another_priority_is_refused() {
        let other = APP.replace("| 5 |", "| 4 |");
        assert!(parse_tasks(&other).unwrap_err().to_string().contains("priority 4"));
        let none = APP.replace("`fast`", "`slow`");
        assert!(parse_tasks(&none).unwrap_err().to_string().contains("no row"));
    }
}
