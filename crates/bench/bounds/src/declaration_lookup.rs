//! How the table of declarations is looked up for an address.

use std::{cell::RefCell, collections::BTreeSet};

use crate::{
    control_flow::BasicBlock,
    declarations::{DeclarationTable, ExcludedCode, SourcePattern},
    decode::ControlFlow,
    image::{FirmwareImage, SourceFrame},
    source_code::SourceCode,
};

/// Functions of the project that wait for what their caller says.
const BUSY_WAIT_FUNCTIONS: [&str; 1] = ["stm32f405::poll_until"];

/// A kind of declaration, and the number of one.
type DeclarationKey = (&'static str, usize);

/// The table, the source that it names lines of, and what of it was used.
pub(crate) struct DeclarationLookup<'a> {
    image: &'a FirmwareImage,
    /// The table.
    pub table: &'a DeclarationTable,
    source: &'a SourceCode,
    used: RefCell<BTreeSet<DeclarationKey>>,
}

impl<'a> DeclarationLookup<'a> {
    /// Returns the table for an image.
    #[must_use]
    pub fn new(
        image: &'a FirmwareImage,
        table: &'a DeclarationTable,
        source: &'a SourceCode,
    ) -> Self {
        Self { image, table, source, used: RefCell::default() }
    }

    /// Returns the same, of which nothing was used.
    #[must_use]
    pub(crate) fn with_usage_reset(&self) -> Self {
        Self::new(self.image, self.table, self.source)
    }

    /// Returns declarations that nothing needed, with their kind.
    #[must_use]
    pub(crate) fn unused_declarations(&self) -> Vec<String> {
        let used = self.used.borrow();
        let kinds: [(&str, Vec<SourcePattern>); 4] = [
            ("loop", self.table.loops.iter().map(|declaration| declaration.at).collect()),
            ("copy", self.table.copies.iter().map(|declaration| declaration.at).collect()),
            ("call", self.table.calls.iter().map(|declaration| declaration.at).collect()),
            ("excluded", self.table.excluded.iter().map(|declaration| declaration.at).collect()),
        ];
        let mut unused = Vec::new();
        for (kind, spots) in kinds {
            for (number, spot) in spots.iter().enumerate() {
                if !used.contains(&(kind, number)) {
                    unused.push(format!("{kind} {} {}", spot.function, spot.line));
                }
            }
        }
        unused
    }

    /// Returns whether a whole function is excluded from a turn.
    pub(crate) fn is_function_excluded(&self, name: &str) -> bool {
        let mut excluded = self.table.excluded.iter().enumerate();
        let found = excluded.find(|(_, declaration)| {
            declaration.at.line.is_empty() && name.contains(declaration.at.function)
        });
        if let Some((number, _)) = found {
            self.used.borrow_mut().insert(("excluded", number));
        }
        found.is_some()
    }

    /// Returns whether all of a block that has a place stands for a line that is excluded from a turn, or its call does.
    pub(crate) fn is_block_excluded(&self, block: &BasicBlock, is_within_line: bool) -> bool {
        let with_line =
            self.table.excluded.iter().filter(|declaration| !declaration.at.line.is_empty());
        let of_lines = self.table.lines.iter().filter(|_| is_within_line);
        for excluded in with_line.chain(of_lines) {
            let last = block.last_instruction();
            let calls = block.call.is_some() || matches!(last.flow, ControlFlow::Call(_));
            let places = if calls { self.image.source_frames(last.at) } else { Vec::new() };
            if places.iter().any(|place| self.matches_location(&excluded.at, place)) {
                self.mark_exclusion_used(excluded);
                return true;
            }
            let mut has_place = false;
            let is_whole = block.instructions.iter().all(|one| {
                let places = self.image.source_frames(one.at);
                let placed = places.iter().any(|place| place.line > 0);
                has_place |= placed;
                !placed || places.iter().any(|place| self.matches_location(&excluded.at, place))
            });
            if has_place && is_whole {
                self.mark_exclusion_used(excluded);
                return true;
            }
        }
        false
    }

    fn mark_exclusion_used(&self, excluded: &ExcludedCode) {
        let number =
            self.table.excluded.iter().position(|declaration| declaration.at == excluded.at);
        self.used.borrow_mut().extend(number.map(|number| ("excluded", number)));
    }

    fn matches_location(&self, spot: &SourcePattern, place: &SourceFrame) -> bool {
        place.function.contains(spot.function)
            && (spot.line.is_empty()
                || self
                    .source
                    .line(&place.file, place.line)
                    .is_some_and(|line| line.contains(spot.line)))
    }

    /// Returns the place of an address as text, innermost function first.
    #[must_use]
    pub(crate) fn format_location(&self, at: u32) -> String {
        let places = self.image.source_frames(at);
        let one = |frame: &SourceFrame| {
            let file = frame.file.rsplit('/').next().unwrap_or_default();
            let line = self.source.line(&frame.file, frame.line).unwrap_or_default();
            format!("{} ({file}:{} `{}`)", frame.function, frame.line, line.trim())
        };
        places.iter().map(one).collect::<Vec<_>>().join(" < ")
    }

    /// Returns the number of the declaration for an address: the first that fits the innermost function has it.
    pub(crate) fn find_declaration_index(
        &self,
        kind: &'static str,
        spots: &[SourcePattern],
        at: u32,
        function: &str,
    ) -> Option<usize> {
        let mut places = self.image.source_frames(at);
        places.push(SourceFrame { function: function.to_owned(), file: String::new(), line: 0 });
        // The innermost function of the project, and what of libraries stands within it.
        let is_own = |place: &SourceFrame| {
            place.function.contains("trueup_")
                && !BUSY_WAIT_FUNCTIONS.iter().any(|function| place.function.contains(function))
        };
        let own = places.iter().position(is_own);
        places.truncate(own.map_or(places.len(), |own| own + 1));
        // Who calls a library knows more than the library.
        for place in places.iter().rev() {
            if let Some(number) = spots.iter().position(|spot| self.matches_location(spot, place)) {
                self.used.borrow_mut().insert((kind, number));
                return Some(number);
            }
        }
        None
    }
}
