//! The functions of an image, as far as a task reaches them: their blocks without those that never come back, the values
//! of their registers, their loops with a bound each, and what they call.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use crate::{
    declared::Declared,
    flow::{self, Call, Graph, returning_blocks},
    image::Image,
    loops::{self, Loop},
    rounds,
    source::Source,
    table::{self, Once, Rounds, Sizes, Spot, Table},
    values::{self, State},
};

/// Numbers in the first four registers at the entry of a function, where they are known.
pub type Arguments = [Option<u32>; 4];

/// A function as it is called: its start and its arguments, if its time depends on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry {
    /// Its first address.
    pub start: u32,
    /// Its arguments; none where its time depends on none.
    pub arguments: Arguments,
    /// Those of its arguments that point into the RAM in this call, a bit each; none where its time depends on no argument.
    pub ram: u16,
}

impl Entry {
    /// Returns a function whose arguments are not known.
    #[must_use]
    pub const fn of(start: u32) -> Self {
        Self { start, arguments: [None; 4], ram: 0 }
    }
}

/// Where a bound comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The instructions.
    Code,
    /// The table.
    Table,
}

/// A loop with its bound.
#[derive(Clone, Debug)]
pub struct Bounded {
    /// The loop.
    pub one: Loop,
    /// How often it goes back to its header.
    pub rounds: Rounds,
    /// Who says so.
    pub origin: Origin,
}

/// A function, ready to be priced.
pub struct Prepared {
    /// Its blocks.
    pub graph: Graph,
    /// The values at the start of each block.
    pub starts: Vec<State>,
    /// Its loops.
    pub loops: Vec<Bounded>,
    /// Functions that each block calls at its end.
    pub calls: Vec<Vec<Entry>>,
}

/// An image with its table.
pub struct Program<'a> {
    /// The image.
    pub image: &'a Image,
    declared: Declared<'a>,
    sizes: Sizes,
    /// No line ends.
    is_within_line: bool,
    /// Arguments of functions that point into the RAM, whoever calls, a bit each.
    ram: RefCell<BTreeMap<u32, u16>>,
    read: RefCell<BTreeMap<u32, Rc<Result<Graph, String>>>>,
    returning: RefCell<BTreeMap<u32, bool>>,
    prepared: RefCell<BTreeMap<Entry, Option<Rc<Prepared>>>>,
    /// Missing bounds, each with its place.
    problems: RefCell<BTreeSet<String>>,
}

impl<'a> Program<'a> {
    /// Returns an image with its table, for calibrations of these sizes at the most. `source` has the lines that the
    /// table names.
    #[must_use]
    pub fn new(image: &'a Image, table: &'a Table, source: &'a Source, sizes: Sizes) -> Self {
        Self {
            image,
            declared: Declared::new(image, table, source),
            sizes,
            is_within_line: false,
            ram: RefCell::default(),
            read: RefCell::default(),
            returning: RefCell::default(),
            prepared: RefCell::default(),
            problems: RefCell::default(),
        }
    }

    /// Returns the same for bytes that end no line.
    #[must_use]
    pub(crate) fn within_line(&self) -> Self {
        Self {
            image: self.image,
            declared: self.declared.again(),
            sizes: self.sizes,
            is_within_line: true,
            ram: self.ram.clone(),
            read: RefCell::default(),
            returning: RefCell::default(),
            prepared: RefCell::default(),
            problems: RefCell::default(),
        }
    }

    /// Finds the arguments that point into the RAM in every call below these functions: all of them, until a call shows
    /// that one does not.
    pub(crate) fn find_ram(&self, entries: &[Entry]) {
        let functions = self.image.functions().map(|it| (it.start, 0b1111));
        self.ram.replace(functions.collect());
        for entry in entries {
            self.ram.borrow_mut().insert(entry.start, 0);
        }
        loop {
            self.prepared.borrow_mut().clear();
            let (mut seen, mut open) = (BTreeSet::new(), entries.to_vec());
            let mut changed = false;
            while let Some(entry) = open.pop() {
                let Some(prepared) = seen.insert(entry).then(|| self.prepare(entry)).flatten()
                else {
                    continue;
                };
                for (number, calls) in prepared.calls.iter().enumerate() {
                    let mut state = prepared.starts[number];
                    for one in &prepared.graph.blocks[number].instructions {
                        state.step(self.image, one);
                    }
                    let is_ram = ram_of(&state);
                    for call in calls {
                        let mut ram = self.ram.borrow_mut();
                        let known = ram.entry(call.start).or_insert(0);
                        changed |= *known & !is_ram != 0;
                        *known &= is_ram;
                    }
                    open.extend(calls);
                }
            }
            if !changed {
                return;
            }
        }
    }

    /// Returns the functions that a turn calls once, and the microseconds between two calls.
    #[must_use]
    pub fn once(&self) -> BTreeMap<u32, Once> {
        let declared = |name: &str| {
            let mut once = self.declared.table.once.iter();
            once.find(|it| name.contains(it.function)).copied()
        };
        let all = self.image.functions();
        all.filter_map(|it| Some((it.start, declared(&it.name)?))).collect()
    }

    /// Returns what was missing so far: loops without a bound, calls that lead to nobody knows where.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        self.problems.borrow().iter().cloned().collect()
    }

    /// Returns declarations that nothing needed.
    #[must_use]
    pub fn unused(&self) -> Vec<String> {
        self.declared.unused()
    }

    /// Returns how many loops the code bounds, and how many the table.
    #[must_use]
    pub(crate) fn origins(&self) -> [usize; 2] {
        let mut counts = BTreeMap::new();
        for (entry, prepared) in self.prepared.borrow().iter() {
            for bounded in prepared.iter().flat_map(|it| it.loops.iter().map(move |one| (it, one)))
            {
                let (prepared, bounded) = bounded;
                let at = prepared.graph.blocks[bounded.one.header].start();
                counts.insert((entry.start, at), bounded.origin);
            }
        }
        [Origin::Code, Origin::Table]
            .map(|origin| counts.values().filter(|it| **it == origin).count())
    }

    /// Adds to what is missing.
    pub(crate) fn complain(&self, text: String) {
        self.problems.borrow_mut().insert(text);
    }

    fn name(&self, start: u32) -> &str {
        self.image.function_at(start).map_or("?", |function| &function.name)
    }

    fn read(&self, start: u32) -> Rc<Result<Graph, String>> {
        if let Some(known) = self.read.borrow().get(&start) {
            return known.clone();
        }
        let function = self.image.function_at(start).ok_or(format!("no function at {start:#x}"));
        let graph = function
            .and_then(|it| Graph::read(self.image, it).map_err(|error| format!("{error:#}")));
        let graph = Rc::new(graph);
        self.read.borrow_mut().insert(start, graph.clone());
        graph
    }

    /// Returns whether a function can come back to its caller. One that is left out of a turn does not.
    fn returns(&self, start: u32) -> bool {
        if let Some(known) = self.returning.borrow().get(&start) {
            return *known;
        }
        let mut reached = BTreeMap::new();
        let mut open = vec![start];
        while let Some(at) = open.pop() {
            if reached.contains_key(&at) {
                continue;
            }
            let graph = self.read(at);
            if let Ok(graph) = &*graph {
                for block in &graph.blocks {
                    if let Some(Call::To(all)) = &block.call {
                        open.extend(all);
                    }
                }
            }
            reached.insert(at, graph);
        }
        let is_excluded = |at: &u32| self.declared.is_function_excluded(self.name(*at));
        let mut known: BTreeMap<u32, bool> = reached.keys().map(|at| (*at, false)).collect();
        loop {
            let mut changed = false;
            for (at, graph) in &reached {
                let is_so = !is_excluded(at)
                    && match &**graph {
                        Ok(graph) => returning_blocks(graph, &|to| known[&to])[0],
                        Err(_) => true,
                    };
                changed |= known.insert(*at, is_so) != Some(is_so);
            }
            if !changed {
                break;
            }
        }
        let is_so = known[&start];
        self.returning.borrow_mut().extend(known);
        is_so
    }

    /// Returns a function that is ready to be priced; `None`, with a complaint: it cannot be read.
    pub fn prepare(&self, entry: Entry) -> Option<Rc<Prepared>> {
        if let Some(known) = self.prepared.borrow().get(&entry) {
            return known.clone();
        }
        let prepared = self.prepare_new(entry);
        self.prepared.borrow_mut().insert(entry, prepared.clone());
        prepared
    }

    fn prepare_new(&self, entry: Entry) -> Option<Rc<Prepared>> {
        let graph = match &*self.read(entry.start) {
            Ok(graph) => graph.clone(),
            Err(error) => {
                self.complain(error.clone());
                return None;
            }
        };
        self.returns(entry.start);
        let is_kept = returning_blocks(&graph, &|to| self.returns(to));
        if !is_kept[0] {
            self.complain(format!("{} never comes back", graph.name));
            return None;
        }
        let mut blocks = graph.blocks;
        for block in &mut blocks {
            // A call that does not come back and is not always made is none.
            if let Some(Call::To(all)) = &block.call
                && !all.iter().any(|to| self.returns(*to))
            {
                block.call = None;
                block.returns = false;
            }
        }
        let graph = flow::keep(graph.name, blocks, &is_kept);
        let ram = self.ram.borrow().get(&entry.start).copied().unwrap_or_default() | entry.ram;
        let mut graph = self.without_excluded(graph)?;
        let mut starts = values::at_starts(self.image, &graph, entry.arguments, ram);
        // A branch by two numbers has one way.
        while let Some(cut) = loops::without_dead_ways(self.image, &graph, &starts) {
            let is_kept = returning_blocks(&cut, &|_| true);
            graph = flow::keep(cut.name, cut.blocks, &is_kept);
            starts = values::at_starts(self.image, &graph, entry.arguments, ram);
        }
        let loops = loops::all(&graph)
            .into_iter()
            .map(|one| self.bound(&graph, &starts, entry.arguments, one))
            .collect();
        let calls =
            (0..graph.blocks.len()).map(|block| self.calls(&graph, &starts, block)).collect();
        Some(Rc::new(Prepared { graph, starts, loops, calls }))
    }

    /// Leaves out the blocks that the table excludes, and those that lead nowhere else.
    fn without_excluded(&self, graph: Graph) -> Option<Graph> {
        let out: Vec<bool> = graph
            .blocks
            .iter()
            .map(|block| self.declared.is_left_out(block, self.is_within_line))
            .collect();
        if !out.contains(&true) {
            return Some(graph);
        }
        let is_in: Vec<bool> = out.iter().map(|it| !it).collect();
        if !is_in[0] {
            self.complain(format!("{} is left out from its entry on", graph.name));
            return None;
        }
        let graph = flow::keep(graph.name, graph.blocks, &is_in);
        let is_kept = returning_blocks(&graph, &|_| true);
        if !is_kept[0] {
            self.complain(format!("{} never comes back without what is left out", graph.name));
            return None;
        }
        Some(flow::keep(graph.name, graph.blocks, &is_kept))
    }

    fn bound(&self, graph: &Graph, starts: &[State], arguments: Arguments, one: Loop) -> Bounded {
        let derived = loops::derived(self.image, graph, starts, &one).map(Rounds::Times);
        let header = graph.blocks[one.header].start();
        let last = one
            .blocks
            .iter()
            .filter(|block| graph.blocks[**block].next.iter().any(|edge| edge.to == one.header));
        let ends = last.map(|block| graph.blocks[*block].last().at);
        let addresses: Vec<u32> = ends.chain([header]).collect();
        let declared = addresses.iter().find_map(|at| {
            let spots: Vec<Spot> = self.declared.table.loops.iter().map(|it| it.at).collect();
            let number = self.declared.find("loop", &spots, *at, &graph.name)?;
            Some(self.declared.table.loops[number].rounds)
        });
        let declared = declared.map(|rounds| {
            let known = rounds::of_loop(rounds, self.image, (graph, starts), arguments, &one);
            match known.unwrap_or_else(|| self.unknown_length(graph)) {
                Rounds::Terms => Rounds::Times(self.sizes.terms),
                Rounds::Tools => Rounds::Times(self.sizes.tools),
                other => other,
            }
        });
        // One that is left behind its body alone goes back once less than it has rounds.
        let declared = declared.map(|rounds| match rounds {
            Rounds::Times(times) if loops::is_tested_behind(graph, &one) => {
                Rounds::Times(times.saturating_sub(1))
            }
            other => other,
        });
        // Of two numbers the smaller one: the table may know more than the code says.
        match (derived, declared) {
            (Some(Rounds::Times(code)), Some(Rounds::Times(table))) if table < code => {
                Bounded { one, rounds: Rounds::Times(table), origin: Origin::Table }
            }
            (Some(_), Some(rounds @ Rounds::Micros(_))) => {
                Bounded { one, rounds, origin: Origin::Table }
            }
            (Some(rounds), _) => Bounded { one, rounds, origin: Origin::Code },
            (None, Some(rounds)) => Bounded { one, rounds, origin: Origin::Table },
            (None, None) => {
                let places: Vec<String> =
                    addresses.iter().map(|at| self.declared.place(*at)).collect();
                let places = places.join("\n    or ");
                self.complain(format!(
                    "loop without a bound in {}, at {header:#x}: {places}",
                    graph.name
                ));
                Bounded { one, rounds: Rounds::Times(0), origin: Origin::Table }
            }
        }
    }

    fn unknown_length(&self, graph: &Graph) -> Rounds {
        self.complain(format!("{} copies an unknown length", graph.name));
        Rounds::Times(1)
    }

    /// Functions that a block calls at its end.
    fn calls(&self, graph: &Graph, starts: &[State], number: usize) -> Vec<Entry> {
        let block = &graph.blocks[number];
        let Some(call) = &block.call else { return Vec::new() };
        let mut state = starts[number];
        for one in &block.instructions {
            state.step(self.image, one);
        }
        let at = block.last().at;
        let targets: Vec<u32> = match call {
            Call::To(all) => all.iter().copied().collect(),
            Call::Register(register) => {
                let known = state.of(*register).as_number().map(|at| at & !1);
                match known.and_then(|at| self.image.function_at(at)) {
                    Some(function) => vec![function.start],
                    None => self.declared_targets(graph, at),
                }
            }
        };
        let back = targets.into_iter().filter(|to| self.returns(*to));
        back.flat_map(|start| {
            let arguments = self.arguments(graph, &state, start, at);
            // One that is copied in many places reads the flash in some of them, and the RAM in others.
            let is_by_length = table::length_argument(self.name(start)).is_some();
            let ram = if is_by_length { ram_of(&state) } else { 0 };
            self.aligned(start, arguments).map(move |arguments| Entry { start, arguments, ram })
        })
        .collect()
    }

    fn declared_targets(&self, graph: &Graph, at: u32) -> Vec<u32> {
        let spots: Vec<Spot> = self.declared.table.calls.iter().map(|it| it.at).collect();
        let Some(number) = self.declared.find("call", &spots, at, &graph.name) else {
            self.complain(format!(
                "call by register in {}, at {at:#x}: {}",
                graph.name,
                self.declared.place(at)
            ));
            return Vec::new();
        };
        let names = self.declared.table.calls[number].functions;
        let is_named = |name: &str| names.iter().any(|part| name.contains(part));
        self.image.functions().filter(|it| is_named(&it.name)).map(|it| it.start).collect()
    }

    /// Of a copy from and to whole words the addresses change nothing but the direction: two are tried for all, both read
    /// from the flash.
    fn aligned(&self, start: u32, arguments: Arguments) -> impl Iterator<Item = Arguments> + use<> {
        const FROM: u32 = 0x0800_1000;
        let name = self.name(start);
        let is_aligned = ["cpy4", "cpy8", "move4", "move8"].iter().any(|it| name.ends_with(it));
        let tried = [FROM + 0x8000, FROM + 4].map(|to| {
            if is_aligned { [Some(to), Some(FROM), arguments[2], None] } else { arguments }
        });
        tried.into_iter().take(if is_aligned { 2 } else { 1 })
    }

    fn arguments(&self, graph: &Graph, state: &State, start: u32, at: u32) -> Arguments {
        let Some(length) = table::length_argument(self.name(start)) else { return [None; 4] };
        let mut arguments: Arguments =
            std::array::from_fn(|register| state.of(register as u8).as_number());
        if arguments[length].is_none() {
            let spots: Vec<Spot> = self.declared.table.copies.iter().map(|it| it.at).collect();
            match self.declared.find("copy", &spots, at, &graph.name) {
                Some(number) => arguments[length] = Some(self.declared.table.copies[number].bytes),
                None => self.complain(format!(
                    "copy of an unknown length in {}, at {at:#x}: {}",
                    graph.name,
                    self.declared.place(at)
                )),
            }
        }
        arguments
    }
}

/// Which of the first four registers point into the RAM, a bit each.
fn ram_of(state: &State) -> u16 {
    (0..4).fold(0, |bits, register| bits | u16::from(state.is_ram(register)) << register)
}
