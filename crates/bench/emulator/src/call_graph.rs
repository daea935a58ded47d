//! Which functions of an image can be reached from one of its functions.
//!
//! The calls are read from the linked image itself, so that nothing is left to what the compiler
//! was believed to do: from the bytes of a function the branches are decoded (Armv7-M, `bl`, `b`,
//! conditional `b`), and where they lead is walked in turn. Data among the code is known by the
//! image's mapping symbols. A branch whose target is in a register cannot be followed; every
//! function with one is reported ([`ReachableFunctions::blind`]). For the stack ([`CallGraph::max_stack_depth`]) a function that
//! branches by a register may call each one whose address it holds.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context as _, Result, ensure};
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SymbolKind};

use crate::stack_frames::{self, StackFrame};

/// The functions of an image and where each of them branches to.
pub struct CallGraph {
    functions: BTreeMap<u64, Function>,
}

struct Function {
    name: String,
    end: u64,
    branches: BranchTargets,
    frame: StackFrame,
}

/// Where a function branches to.
#[derive(Default)]
struct BranchTargets {
    targets: BTreeSet<u64>,
    /// Those of them that it calls: it goes on behind.
    calls: BTreeSet<u64>,
    /// It branches to what a register says.
    by_register: bool,
    /// It has the instruction that is nothing but a trap.
    traps: bool,
}

/// Functions that can be reached from one, itself included, by the names of the linker.
#[derive(Default, Debug)]
pub struct ReachableFunctions {
    /// All of them.
    pub names: BTreeSet<String>,
    /// Those that branch to what a register says: their calls are not all seen.
    pub blind: BTreeSet<String>,
    /// Those with an undefined instruction, which is how `abort` and unreachable code end.
    pub traps: BTreeSet<String>,
}

impl ReachableFunctions {
    /// Returns what of it makes a panic: functions of that name, traps, and what could not be followed.
    #[must_use]
    pub fn potential_panic_sources(&self) -> Vec<&str> {
        let named = self.names.iter().filter(|name| name.contains("panic"));
        named.chain(&self.traps).chain(&self.blind).map(String::as_str).collect()
    }
}

impl CallGraph {
    /// Reads the functions of an image.
    ///
    /// # Errors
    /// It cannot be read, or has no symbols.
    pub fn read(image: &Path) -> Result<Self> {
        let bytes = fs::read(image).with_context(|| image.display().to_string())?;
        let file = object::File::parse(&*bytes)?;
        let mut functions = BTreeMap::new();
        // `$t` and `$d` begin stretches of instructions and of data.
        let mut data: BTreeMap<u64, bool> = BTreeMap::new();
        for symbol in file.symbols() {
            let name = symbol.name()?;
            if name.starts_with("$t") || name.starts_with("$d") {
                data.insert(symbol.address(), name.starts_with("$d"));
            }
        }
        for symbol in file.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text) {
            let start = symbol.address() & !1;
            let section = symbol.section_index().map(|index| file.section_by_index(index));
            let Some(Ok(section)) = section else { continue };
            let Some(code) = section.data_range(start, symbol.size())? else { continue };
            if code.is_empty() {
                continue;
            }
            let is_data =
                |at: u64| data.range(..=at).next_back().is_some_and(|(_, is_data)| *is_data);
            functions.insert(
                start,
                Function {
                    name: symbol.name()?.to_owned(),
                    end: start + symbol.size(),
                    branches: decode_branches(code, start, is_data),
                    frame: stack_frames::analyse_stack_frame(code, start, is_data),
                },
            );
        }
        ensure!(!functions.is_empty(), "{} has no symbols", image.display());
        Ok(Self { functions })
    }

    /// Returns what can be reached from the function whose linker name contains `part`.
    ///
    /// # Errors
    /// There is none, or more than one.
    pub fn reachable_from(&self, part: &str) -> Result<ReachableFunctions> {
        let named = |function: &&Function| function.name.contains(part);
        let starts: Vec<_> =
            self.functions.iter().filter(|(_, function)| named(function)).collect();
        ensure!(starts.len() == 1, "{} functions have {part} in their name", starts.len());
        let mut reached = ReachableFunctions::default();
        let mut seen = BTreeSet::new();
        let mut open: Vec<u64> = starts.iter().map(|(start, _)| **start).collect();
        while let Some(start) = open.pop() {
            if !seen.insert(start) {
                continue;
            }
            let function = &self.functions[&start];
            reached.names.insert(function.name.clone());
            if function.branches.by_register {
                reached.blind.insert(function.name.clone());
            }
            if function.branches.traps {
                reached.traps.insert(function.name.clone());
            }
            for target in &function.branches.targets {
                let (start, _) = self
                    .functions
                    .range(..=target)
                    .next_back()
                    .filter(|(_, function)| *target < function.end)
                    .with_context(|| format!("{} branches to no function", function.name))?;
                open.push(*start);
            }
        }
        Ok(reached)
    }
}

/// The stack that a function takes, with those that it calls.
#[derive(Clone, Debug, Default)]
pub struct StackDepth {
    /// Bytes of the deepest chain of calls.
    pub bytes: u64,
    /// Its functions, from the outermost one.
    pub chain: Vec<String>,
    /// Those that call what no address in them says, anywhere below: their calls are not counted.
    pub blind: BTreeSet<String>,
}

impl CallGraph {
    /// Returns the deepest stack of the function of this name. Those with a part of `without` in their name are excluded
    /// below it, and all that they call.
    ///
    /// # Errors
    /// There is no such function, a call leads to none, a function calls itself, functions call each other in a circle, or
    /// one takes as much as a register says.
    pub fn max_stack_depth(&self, name: &str, without: &[&str]) -> Result<StackDepth> {
        let start = self.functions.iter().find(|(_, function)| function.name == name);
        let (start, _) = start.with_context(|| format!("no function is called {name}"))?;
        self.stack_depth_from(*start, without, &mut BTreeMap::new(), &mut Vec::new())
    }

    /// Returns the deepest stack of all functions with one of these parts in their name, as [`Self::max_stack_depth`].
    ///
    /// # Errors
    /// As there.
    pub fn max_stack_depth_matching(&self, parts: &[&str], without: &[&str]) -> Result<StackDepth> {
        let (mut known, mut all) = (BTreeMap::new(), StackDepth::default());
        for (start, function) in &self.functions {
            if parts.iter().any(|part| function.name.contains(part)) {
                let depth = self.stack_depth_from(*start, without, &mut known, &mut Vec::new())?;
                if depth.bytes > all.bytes {
                    all = depth;
                }
            }
        }
        Ok(all)
    }

    fn stack_depth_from(
        &self,
        start: u64,
        without: &[&str],
        known: &mut BTreeMap<u64, StackDepth>,
        above: &mut Vec<u64>,
    ) -> Result<StackDepth> {
        if let Some(depth) = known.get(&start) {
            return Ok(depth.clone());
        }
        let Function { name, branches, frame, .. } = &self.functions[&start];
        ensure!(!above.contains(&start), "{name} calls itself, in a circle");
        ensure!(!frame.is_open, "{name} takes as much of the stack as a register says");
        let held = frame.pointers.iter().map(|pointer| pointer - 1);
        let held: Vec<u64> = held.filter(|at| self.functions.contains_key(at)).collect();
        let mut depth = StackDepth::default();
        if branches.by_register && held.is_empty() {
            depth.blind.insert(name.clone());
        }
        above.push(start);
        for target in branches.targets.iter().chain(&held) {
            let (called, function) = self
                .functions
                .range(..=target)
                .next_back()
                .filter(|(_, function)| *target < function.end)
                .with_context(|| format!("{name} branches to no function"))?;
            if *called == start {
                // A branch within it takes no stack, a call does.
                let is_call = branches.calls.contains(target) || held.contains(target);
                ensure!(
                    !is_call,
                    "{name} calls itself, and nothing says how deep: write it without"
                );
                continue;
            }
            if without.iter().any(|part| function.name.contains(part)) {
                continue;
            }
            let below = self.stack_depth_from(*called, without, known, above)?;
            depth.blind.extend(below.blind);
            if below.bytes > depth.bytes {
                (depth.bytes, depth.chain) = (below.bytes, below.chain);
            }
        }
        above.pop();
        depth.bytes += frame.bytes;
        depth.chain.insert(0, name.clone());
        known.insert(start, depth.clone());
        Ok(depth)
    }
}

/// Returns the branches in the bytes of a function that begins at `start`.
fn decode_branches(code: &[u8], start: u64, is_data: impl Fn(u64) -> bool) -> BranchTargets {
    let mut branches = BranchTargets::default();
    let halves: Vec<u16> =
        code.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect();
    let mut number = 0;
    while let Some(&first) = halves.get(number) {
        let at = start + 2 * number as u64;
        number += 1;
        if is_data(at) {
            continue;
        }
        let is_wide = first >> 11 >= 0b11101;
        let offset = if is_wide {
            let second = halves.get(number).copied().unwrap_or_default();
            number += 1;
            branches.by_register |= is_indirect_branch(first, second);
            branches.traps |= first >> 4 == 0xF7F && second >> 12 == 0xA;
            branch_offset_32(first, second)
        } else {
            // `bx` and `blx` of a register other than the link register; `mov` to the counter.
            branches.by_register |=
                (first & 0xFF00 == 0x4700 && first & 0x78 != 14 << 3) || first & 0xFF87 == 0x4687;
            branches.traps |= first >> 8 == 0xDE;
            branch_offset_16(first)
        };
        if let Some(offset) = offset {
            let target = (at + 4).wrapping_add_signed(offset);
            branches.targets.insert(target);
            if is_wide && is_branch_with_link(halves.get(number - 1).copied().unwrap_or_default()) {
                branches.calls.insert(target);
            }
        }
    }
    branches
}

/// Returns the low `bits` bits as a number with a sign.
fn sign_extend(value: u32, bits: u32) -> i64 {
    let unused = 32 - bits;
    i64::from((value << unused).cast_signed() >> unused)
}

/// `b` and conditional `b` of 16 bits; `cbz` stays within its function.
fn branch_offset_16(half: u16) -> Option<i64> {
    let half = u32::from(half);
    match half >> 12 {
        // The conditions 14 and 15 are `udf` and `svc`.
        0b1101 if (half >> 8) & 15 < 14 => Some(sign_extend(half & 0xFF, 8) * 2),
        0b1110 if half >> 11 == 0b11100 => Some(sign_extend(half & 0x7FF, 11) * 2),
        _ => None,
    }
}

/// `bl`, `b.w` and conditional `b.w`.
fn branch_offset_32(first: u16, second: u16) -> Option<i64> {
    let (first, second) = (u32::from(first), u32::from(second));
    if first >> 11 != 0b11110 || second >> 15 != 1 {
        return None;
    }
    let bit = |word: u32, number: u32| (word >> number) & 1;
    let (sign, j1, j2) = (bit(first, 10), bit(second, 13), bit(second, 11));
    let low = second & 0x7FF;
    if bit(second, 12) == 1 {
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        let high = (first & 0x3FF) << 11;
        Some(sign_extend(sign << 23 | i1 << 22 | i2 << 21 | high | low, 24) * 2)
    } else if bit(second, 14) == 0 && (first >> 6) & 15 < 14 {
        let high = (first & 0x3F) << 11;
        Some(sign_extend(sign << 19 | j2 << 18 | j1 << 17 | high | low, 20) * 2)
    } else {
        None
    }
}

/// Returns whether a wide branch with this second half-word is `bl`.
fn is_branch_with_link(second: u16) -> bool {
    second >> 14 == 0b11 && second >> 12 & 1 == 1
}

/// A load into the counter other than a return (`pop`). A jump table (`tbb`, `tbh`) stays within
/// its function.
fn is_indirect_branch(first: u16, second: u16) -> bool {
    // `ldr.w pc, …`; `ldr pc, [sp], #4` is a `pop` of one register.
    first & 0xFF70 == 0xF850 && second >> 12 == 15 && !(first == 0xF85D && second == 0xFB04)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn targets(code: &[u16]) -> Vec<u64> {
        let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        decode_branches(&bytes, 0x1000, |_| false).targets.into_iter().collect()
    }

    #[test]
    fn branches_lead_where_the_disassembler_says() {
        // b.n to itself and 4 back; beq.n 6 on; bl 4 on and 4 back; b.w 16 M on; bne.w 4 back.
        assert_eq!(targets(&[0xE7FE]), [0x1000]);
        assert_eq!(targets(&[0xE7FC]), [0x0FFC]);
        assert_eq!(targets(&[0xD001]), [0x1006]);
        assert_eq!(targets(&[0xF000, 0xF800]), [0x1004]);
        assert_eq!(targets(&[0xF7FF, 0xFFFC]), [0x0FFC]);
        assert_eq!(targets(&[0xF3FF, 0x97FF]), [0x100_1002]);
        assert_eq!(targets(&[0xF47F, 0xAFFC]), [0x0FFC]);
        // mov.w, ldr.w, udiv, pop.w branch nowhere.
        assert_eq!(
            targets(&[0xF04F, 0x30FF, 0xF8D0, 0x1000, 0xFBB1, 0xF0F2, 0xE8BD, 0x8FF0]),
            [0; 0]
        );
    }

    /// Functions at 0x1000, 0x1100, …, by their half-words.
    fn graph(code: &[(&str, &[u16])]) -> CallGraph {
        let function = |(number, (name, halves)): (usize, &(&str, &[u16]))| {
            let start = 0x1000 + 0x100 * number as u64;
            let bytes: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
            let function = Function {
                name: (*name).to_owned(),
                end: start + bytes.len() as u64,
                branches: decode_branches(&bytes, start, |_| false),
                frame: stack_frames::analyse_stack_frame(&bytes, start, |_| false),
            };
            (start, function)
        };
        CallGraph { functions: code.iter().enumerate().map(function).collect() }
    }

    #[test]
    fn a_function_that_calls_itself_has_no_bound() {
        // push {r4, lr}; bl .-2; pop {r4, pc}.
        let recursive = graph(&[("itself", &[0xB510, 0xF7FF, 0xFFFD, 0xBD10])]);
        let error = recursive.max_stack_depth("itself", &[]).unwrap_err().to_string();
        assert!(error.starts_with("itself calls itself, and nothing says how deep"), "{error}");
        // A loop back to the first instruction, and one to the second, are no calls: push {r4, lr}; b .-4.
        for back in [0xE7FD, 0xE7FE] {
            let looped = graph(&[("looped", &[0xB510, back, 0xBD10])]);
            assert_eq!(looped.max_stack_depth("looped", &[]).unwrap().bytes, 8);
        }
        // Through a second one it is a circle.
        let circle = graph(&[
            ("first", &[0xB510, 0xF000, 0xF87D, 0xBD10]),
            ("second", &[0xB510, 0xF7FF, 0xFF7D, 0xBD10]),
        ]);
        let error = circle.max_stack_depth("first", &[]).unwrap_err().to_string();
        assert_eq!(error, "first calls itself, in a circle");
    }

    #[test]
    fn what_cannot_be_followed_is_reported() {
        let of = |half: u16| decode_branches(&half.to_le_bytes(), 0, |_| false);
        assert!(of(0x4798).by_register, "blx r3");
        assert!(of(0x4718).by_register, "bx r3");
        assert!(!of(0x4770).by_register, "bx lr");
        assert!(of(0xDEFE).traps, "udf");
    }
}
