//! The functions of an image, as far as a task reaches them: their blocks without those that never come back, the values
//! of their registers, their loops with a bound each, and what they call.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use crate::{
    control_flow::{self, Call, ControlFlowGraph, find_returning_blocks},
    declaration_lookup::DeclarationLookup,
    declarations::{
        self, CalibrationSizes, DeclarationTable, IterationBound, RateLimitedFunction,
        SourcePattern,
    },
    function_entry::{FunctionEntry, KnownArguments},
    image::FirmwareImage,
    iteration_bounds,
    loop_analysis::{self, Loop},
    prepared_function::{BoundOrigin, BoundedLoop, PreparedFunction},
    register_values::{self, RegisterState},
    source_code::SourceCode,
};

/// An image with its table.
pub struct Program<'a> {
    /// The image.
    pub image: &'a FirmwareImage,
    declared: DeclarationLookup<'a>,
    sizes: CalibrationSizes,
    /// No line ends.
    is_within_line: bool,
    /// Arguments of functions that point into the RAM for any caller, a bit each.
    ram: RefCell<BTreeMap<u32, u16>>,
    read: RefCell<BTreeMap<u32, Rc<Result<ControlFlowGraph, String>>>>,
    returning: RefCell<BTreeMap<u32, bool>>,
    prepared: RefCell<BTreeMap<FunctionEntry, Option<Rc<PreparedFunction>>>>,
    /// Missing bounds, each with its place.
    problems: RefCell<BTreeSet<String>>,
}

impl<'a> Program<'a> {
    /// Returns an image with its table, for calibrations of these sizes at the most. `source` has the lines that the
    /// table names.
    #[must_use]
    pub fn new(
        image: &'a FirmwareImage,
        table: &'a DeclarationTable,
        source: &'a SourceCode,
        sizes: CalibrationSizes,
    ) -> Self {
        Self {
            image,
            declared: DeclarationLookup::new(image, table, source),
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
    pub(crate) fn for_bytes_within_line(&self) -> Self {
        Self {
            image: self.image,
            declared: self.declared.with_usage_reset(),
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
    pub(crate) fn determine_ram_arguments(&self, entries: &[FunctionEntry]) {
        let functions = self.image.functions().map(|function| (function.start, 0b1111));
        self.ram.replace(functions.collect());
        for entry in entries {
            self.ram.borrow_mut().insert(entry.start, 0);
        }
        loop {
            self.prepared.borrow_mut().clear();
            let (mut seen, mut open) = (BTreeSet::new(), entries.to_vec());
            let mut changed = false;
            while let Some(entry) = open.pop() {
                let Some(prepared) =
                    seen.insert(entry).then(|| self.prepare_function(entry)).flatten()
                else {
                    continue;
                };
                for (number, calls) in prepared.calls.iter().enumerate() {
                    let mut state = prepared.starts[number];
                    for one in &prepared.graph.blocks[number].instructions {
                        state.execute_checking_condition(self.image, one);
                    }
                    let is_ram = state.argument_ram_pointer_mask();
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
    pub(crate) fn rate_limited_functions(&self) -> BTreeMap<u32, RateLimitedFunction> {
        let declared = |name: &str| {
            let mut once = self.declared.table.once.iter();
            once.find(|one| one.function.split('|').any(|part| name.contains(part))).copied()
        };
        let all = self.image.functions();
        all.filter_map(|function| Some((function.start, declared(&function.name)?))).collect()
    }

    /// Returns what was missing so far: loops without a bound, calls with an unknown target.
    #[must_use]
    pub fn missing_flow_facts(&self) -> Vec<String> {
        self.problems.borrow().iter().cloned().collect()
    }

    /// Returns declarations that nothing needed.
    #[must_use]
    pub(crate) fn unused_declarations(&self) -> Vec<String> {
        self.declared.unused_declarations()
    }

    /// Returns how many loops the code bounds, and how many the table.
    #[must_use]
    pub(crate) fn loop_counts_by_bound_origin(&self) -> [usize; 2] {
        let mut counts = BTreeMap::new();
        for (entry, prepared) in self.prepared.borrow().iter() {
            for bounded in prepared
                .iter()
                .flat_map(|function| function.loops.iter().map(move |one| (function, one)))
            {
                let (prepared, bounded) = bounded;
                let at = prepared.graph.blocks[bounded.one.header].start_address();
                counts.insert((entry.start, at), bounded.origin);
            }
        }
        [BoundOrigin::Code, BoundOrigin::Table]
            .map(|origin| counts.values().filter(|count| **count == origin).count())
    }

    /// Adds to what is missing.
    pub(crate) fn record_problem(&self, text: String) {
        self.problems.borrow_mut().insert(text);
    }

    fn function_name(&self, start: u32) -> &str {
        self.image.function_at(start).map_or("?", |function| &function.name)
    }

    fn control_flow_graph(&self, start: u32) -> Rc<Result<ControlFlowGraph, String>> {
        if let Some(known) = self.read.borrow().get(&start) {
            return known.clone();
        }
        let function = self.image.function_at(start).ok_or(format!("no function at {start:#x}"));
        let graph = function.and_then(|function| {
            ControlFlowGraph::read(self.image, function).map_err(|error| format!("{error:#}"))
        });
        let graph = Rc::new(graph);
        self.read.borrow_mut().insert(start, graph.clone());
        graph
    }

    /// Returns whether a function can come back to its caller. One that is excluded from a turn does not.
    fn can_return(&self, start: u32) -> bool {
        if let Some(known) = self.returning.borrow().get(&start) {
            return *known;
        }
        let mut reached = BTreeMap::new();
        let mut open = vec![start];
        while let Some(at) = open.pop() {
            if reached.contains_key(&at) {
                continue;
            }
            let graph = self.control_flow_graph(at);
            if let Ok(graph) = &*graph {
                for block in &graph.blocks {
                    if let Some(Call::Direct(all)) = &block.call {
                        open.extend(all);
                    }
                }
            }
            reached.insert(at, graph);
        }
        let is_excluded = |at: &u32| self.declared.is_function_excluded(self.function_name(*at));
        let mut known: BTreeMap<u32, bool> = reached.keys().map(|at| (*at, false)).collect();
        loop {
            let mut changed = false;
            for (at, graph) in &reached {
                let is_so = !is_excluded(at)
                    && match &**graph {
                        Ok(graph) => find_returning_blocks(graph, &|to| known[&to])[0],
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
    pub(crate) fn prepare_function(&self, entry: FunctionEntry) -> Option<Rc<PreparedFunction>> {
        if let Some(known) = self.prepared.borrow().get(&entry) {
            return known.clone();
        }
        let prepared = self.prepare_function_uncached(entry);
        self.prepared.borrow_mut().insert(entry, prepared.clone());
        prepared
    }

    fn prepare_function_uncached(&self, entry: FunctionEntry) -> Option<Rc<PreparedFunction>> {
        let graph = match &*self.control_flow_graph(entry.start) {
            Ok(graph) => graph.clone(),
            Err(error) => {
                self.record_problem(error.clone());
                return None;
            }
        };
        self.can_return(entry.start);
        let is_kept = find_returning_blocks(&graph, &|to| self.can_return(to));
        if !is_kept[0] {
            self.record_problem(format!("{} never comes back", graph.name));
            return None;
        }
        let mut blocks = graph.blocks;
        for block in &mut blocks {
            // A call that does not come back and is not always made is none.
            if let Some(Call::Direct(all)) = &block.call
                && !all.iter().any(|to| self.can_return(*to))
            {
                block.call = None;
                block.returns = false;
            }
        }
        let graph = control_flow::subgraph(graph.name, blocks, &is_kept);
        let ram = self.ram.borrow().get(&entry.start).copied().unwrap_or_default() | entry.ram;
        let mut graph = self.remove_excluded_blocks(graph)?;
        let mut starts =
            register_values::compute_block_entry_states(self.image, &graph, entry.arguments, ram);
        // A branch by two numbers has one way.
        while let Some(cut) = loop_analysis::prune_infeasible_edges(self.image, &graph, &starts) {
            let is_kept = find_returning_blocks(&cut, &|_| true);
            graph = control_flow::subgraph(cut.name, cut.blocks, &is_kept);
            starts = register_values::compute_block_entry_states(
                self.image,
                &graph,
                entry.arguments,
                ram,
            );
        }
        let loops = loop_analysis::find_loops(&graph)
            .into_iter()
            .map(|one| self.bound_loop(&graph, &starts, entry.arguments, one))
            .collect();
        let calls = (0..graph.blocks.len())
            .map(|block| self.resolve_called_functions(&graph, &starts, block))
            .collect();
        Some(Rc::new(PreparedFunction { graph, starts, loops, calls }))
    }

    /// Leaves out the blocks that the table excludes, and those that lead nowhere else.
    fn remove_excluded_blocks(&self, graph: ControlFlowGraph) -> Option<ControlFlowGraph> {
        let out: Vec<bool> = graph
            .blocks
            .iter()
            .map(|block| self.declared.is_block_excluded(block, self.is_within_line))
            .collect();
        if !out.contains(&true) {
            return Some(graph);
        }
        let is_in: Vec<bool> = out.iter().map(|value| !value).collect();
        if !is_in[0] {
            self.record_problem(format!("{} is excluded from its entry on", graph.name));
            return None;
        }
        let graph = control_flow::subgraph(graph.name, graph.blocks, &is_in);
        let is_kept = find_returning_blocks(&graph, &|_| true);
        if !is_kept[0] {
            self.record_problem(format!(
                "{} never returns without the excluded blocks",
                graph.name
            ));
            return None;
        }
        Some(control_flow::subgraph(graph.name, graph.blocks, &is_kept))
    }

    fn bound_loop(
        &self,
        graph: &ControlFlowGraph,
        starts: &[RegisterState],
        arguments: KnownArguments,
        one: Loop,
    ) -> BoundedLoop {
        let derived = loop_analysis::derive_iteration_bound(self.image, graph, starts, &one)
            .map(IterationBound::AtMost);
        let header = graph.blocks[one.header].start_address();
        let last = one
            .blocks
            .iter()
            .filter(|block| graph.blocks[**block].next.iter().any(|edge| edge.to == one.header));
        let ends = last.map(|block| graph.blocks[*block].last_instruction().at);
        let addresses: Vec<u32> = ends.chain([header]).collect();
        let declared = addresses.iter().find_map(|at| {
            let spots: Vec<SourcePattern> =
                self.declared.table.loops.iter().map(|declaration| declaration.at).collect();
            let number = self.declared.find_declaration_index("loop", &spots, *at, &graph.name)?;
            Some(self.declared.table.loops[number].rounds)
        });
        let declared = declared.map(|rounds| {
            let known = iteration_bounds::resolve_iteration_bound(
                rounds,
                self.image,
                (graph, starts),
                arguments,
                &one,
            );
            match known.unwrap_or_else(|| self.report_unknown_copy_length(graph)) {
                IterationBound::PerTerm => IterationBound::AtMost(self.sizes.terms),
                IterationBound::PerTool => IterationBound::AtMost(self.sizes.tools),
                other => other,
            }
        });
        // One that is left behind its body alone goes back once less than it has rounds.
        let declared = declared.map(|rounds| match rounds {
            IterationBound::AtMost(times) if loop_analysis::is_post_tested(graph, &one) => {
                IterationBound::AtMost(times.saturating_sub(1))
            }
            other => other,
        });
        // Of two numbers the smaller one: the table may know more than the code says.
        match (derived, declared) {
            (Some(IterationBound::AtMost(code)), Some(IterationBound::AtMost(table)))
                if table < code =>
            {
                BoundedLoop {
                    one,
                    rounds: IterationBound::AtMost(table),
                    origin: BoundOrigin::Table,
                }
            }
            (Some(_), Some(rounds @ IterationBound::Microseconds(_))) => {
                BoundedLoop { one, rounds, origin: BoundOrigin::Table }
            }
            (Some(rounds), _) => BoundedLoop { one, rounds, origin: BoundOrigin::Code },
            (None, Some(rounds)) => BoundedLoop { one, rounds, origin: BoundOrigin::Table },
            (None, None) => {
                let places: Vec<String> =
                    addresses.iter().map(|at| self.declared.format_location(*at)).collect();
                let places = places.join("\n    or ");
                self.record_problem(format!(
                    "loop without a bound in {}, at {header:#x}: {places}",
                    graph.name
                ));
                BoundedLoop { one, rounds: IterationBound::AtMost(0), origin: BoundOrigin::Table }
            }
        }
    }

    fn report_unknown_copy_length(&self, graph: &ControlFlowGraph) -> IterationBound {
        self.record_problem(format!("{} copies an unknown length", graph.name));
        IterationBound::AtMost(1)
    }

    /// Functions that a block calls at its end.
    fn resolve_called_functions(
        &self,
        graph: &ControlFlowGraph,
        starts: &[RegisterState],
        number: usize,
    ) -> Vec<FunctionEntry> {
        let block = &graph.blocks[number];
        let Some(call) = &block.call else { return Vec::new() };
        let mut state = starts[number];
        for one in &block.instructions {
            state.execute_checking_condition(self.image, one);
        }
        let at = block.last_instruction().at;
        let targets: Vec<u32> = match call {
            Call::Direct(all) => all.iter().copied().collect(),
            Call::Indirect(register) => {
                let known = state.register_value(*register).as_constant().map(|at| at & !1);
                match known.and_then(|at| self.image.function_at(at)) {
                    Some(function) => vec![function.start],
                    None => self.find_declared_call_targets(graph, at),
                }
            }
        };
        let back = targets.into_iter().filter(|to| self.can_return(*to));
        back.flat_map(|start| {
            let arguments = self.resolve_call_arguments(graph, &state, start, at);
            // One that is copied in many places reads the flash in some of them, and the RAM in others.
            let is_by_length =
                declarations::length_argument_index(self.function_name(start)).is_some();
            let ram = if is_by_length { state.argument_ram_pointer_mask() } else { 0 };
            self.copy_direction_cases(start, arguments).map(move |arguments| FunctionEntry {
                start,
                arguments,
                ram,
            })
        })
        .collect()
    }

    fn find_declared_call_targets(&self, graph: &ControlFlowGraph, at: u32) -> Vec<u32> {
        let spots: Vec<SourcePattern> =
            self.declared.table.calls.iter().map(|declaration| declaration.at).collect();
        let Some(number) = self.declared.find_declaration_index("call", &spots, at, &graph.name)
        else {
            self.record_problem(format!(
                "call by register in {}, at {at:#x}: {}",
                graph.name,
                self.declared.format_location(at)
            ));
            return Vec::new();
        };
        let names = self.declared.table.calls[number].functions;
        let is_named = |name: &str| names.iter().any(|part| name.contains(part));
        self.image
            .functions()
            .filter(|function| is_named(&function.name))
            .map(|function| function.start)
            .collect()
    }

    /// Of a copy from and to whole words the addresses change nothing but the direction: two are tried for all, both read
    /// from the flash.
    fn copy_direction_cases(
        &self,
        start: u32,
        arguments: KnownArguments,
    ) -> impl Iterator<Item = KnownArguments> + use<> {
        const ASSUMED_COPY_SOURCE_ADDRESS: u32 = 0x0800_1000;
        let name = self.function_name(start);
        let is_aligned =
            ["cpy4", "cpy8", "move4", "move8"].iter().any(|suffix| name.ends_with(suffix));
        let tried =
            [ASSUMED_COPY_SOURCE_ADDRESS + 0x8000, ASSUMED_COPY_SOURCE_ADDRESS + 4].map(|to| {
                if is_aligned {
                    [Some(to), Some(ASSUMED_COPY_SOURCE_ADDRESS), arguments[2], None]
                } else {
                    arguments
                }
            });
        tried.into_iter().take(if is_aligned { 2 } else { 1 })
    }

    fn resolve_call_arguments(
        &self,
        graph: &ControlFlowGraph,
        state: &RegisterState,
        start: u32,
        at: u32,
    ) -> KnownArguments {
        let Some(length) = declarations::length_argument_index(self.function_name(start)) else {
            return [None; 4];
        };
        let mut arguments: KnownArguments =
            std::array::from_fn(|register| state.register_value(register as u8).as_constant());
        if arguments[length].is_none() {
            let spots: Vec<SourcePattern> =
                self.declared.table.copies.iter().map(|declaration| declaration.at).collect();
            match self.declared.find_declaration_index("copy", &spots, at, &graph.name) {
                Some(number) => arguments[length] = Some(self.declared.table.copies[number].bytes),
                None => self.record_problem(format!(
                    "copy of an unknown length in {}, at {at:#x}: {}",
                    graph.name,
                    self.declared.format_location(at)
                )),
            }
        }
        arguments
    }
}
