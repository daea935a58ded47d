//! The linked image: its functions, its words, and where in the source each address comes from.

use std::{collections::BTreeMap, fs, path::Path, rc::Rc};

use addr2line::Context;
use anyhow::{Context as _, Result, ensure};
use gimli::{EndianRcSlice, LittleEndian};
use object::{Object as _, ObjectSection as _, ObjectSegment as _, ObjectSymbol as _, SymbolKind};

/// A function.
#[derive(Clone, Debug)]
pub struct Function {
    /// Its name, without the hash of the compiler.
    pub name: String,
    /// Its first address.
    pub start: u32,
    /// The address behind it.
    pub end: u32,
}

/// A place in the source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SourceFrame {
    /// The function there, with its path.
    pub function: String,
    /// The file.
    pub file: String,
    /// The line.
    pub line: u32,
}

/// A linked image, in memory.
pub struct FirmwareImage {
    functions: BTreeMap<u32, Function>,
    /// Stretches of code (false) and data (true) among it, by the mapping symbols.
    data: BTreeMap<u32, bool>,
    /// Content of the flash: address and bytes.
    segments: Vec<(u32, Vec<u8>)>,
    symbols: BTreeMap<String, u32>,
    source: Option<Context<EndianRcSlice<LittleEndian>>>,
}

impl FirmwareImage {
    /// Reads an image.
    ///
    /// # Errors
    /// The file cannot be read, is no ELF file, or has no functions.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&bytes).with_context(|| path.display().to_string())
    }

    /// As [`Self::read`], of bytes.
    ///
    /// # Errors
    /// As there.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let file = object::File::parse(bytes)?;
        let (mut functions, mut data, mut symbols) =
            (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        for symbol in file.symbols() {
            let (name, at) = (symbol.name()?, symbol.address() as u32);
            if name.starts_with("$t") || name.starts_with("$d") {
                data.insert(at, name.starts_with("$d"));
                continue;
            }
            symbols.insert(name.to_owned(), at);
            if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
                let start = at & !1;
                let name = format!("{:#}", addr2line::demangle_auto(name.into(), None));
                let function = Function { name, start, end: start + symbol.size() as u32 };
                functions.insert(start, function);
            }
        }
        ensure!(!functions.is_empty(), "there are no functions: link the image with its symbols");
        let mut segments = Vec::new();
        for segment in file.segments() {
            segments.push((segment.address() as u32, segment.data()?.to_vec()));
        }
        let dwarf = gimli::Dwarf::load(|id| -> Result<_> {
            let section = file.section_by_name(id.name());
            let bytes =
                section.map(|section| section.uncompressed_data()).transpose()?.unwrap_or_default();
            Ok(EndianRcSlice::new(Rc::from(&*bytes), LittleEndian))
        })?;
        Ok(Self { functions, data, segments, symbols, source: Context::from_dwarf(dwarf).ok() })
    }

    /// Returns an image of functions: name, address, half-words. They have no source.
    #[must_use]
    pub fn from_code(code: &[(&str, u32, &[u16])]) -> Self {
        let mut image = Self {
            functions: BTreeMap::new(),
            data: BTreeMap::new(),
            segments: Vec::new(),
            symbols: BTreeMap::new(),
            source: None,
        };
        for (name, start, halves) in code {
            let bytes: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
            let (name, start) = ((*name).to_owned(), *start);
            let end = start + bytes.len() as u32;
            image.symbols.insert(name.clone(), start);
            image.functions.insert(start, Function { name, start, end });
            image.segments.push((start, bytes));
        }
        image
    }

    /// Returns the function at an address.
    #[must_use]
    pub(crate) fn function_at(&self, at: u32) -> Option<&Function> {
        let (_, function) = self.functions.range(..=at).next_back()?;
        (at < function.end).then_some(function)
    }

    /// Returns the function of a name of the linker.
    #[must_use]
    pub(crate) fn function_by_symbol(&self, symbol: &str) -> Option<&Function> {
        self.functions.get(&(self.symbols.get(symbol)? & !1))
    }

    /// Returns the number of the exception whose handler a function is: its place in the table of vectors (Armv7-M,
    /// B1.5.3), which stands where the image begins.
    #[must_use]
    pub(crate) fn exception_number(&self, start: u32) -> Option<u32> {
        let table = *self.symbols.get("__vector_table")?;
        // 16 of the core and 82 of the chip (RM0090, table 62).
        (1..98).find(|number| self.flash_word(table + 4 * number) == Some(start | 1))
    }

    /// Returns all functions.
    pub fn functions(&self) -> impl Iterator<Item = &Function> {
        self.functions.values()
    }

    /// Returns whether there is data at an address among the code.
    #[must_use]
    pub fn is_data(&self, at: u32) -> bool {
        self.data.range(..=at).next_back().is_some_and(|(_, is_data)| *is_data)
    }

    /// Returns where the stretch of code or data at an address ends.
    #[must_use]
    pub fn region_end(&self, at: u32) -> u32 {
        let is_data = self.is_data(at);
        let next = self.data.range(at + 1..).find(|(_, other)| **other != is_data);
        next.map_or(u32::MAX, |(end, _)| *end)
    }

    /// Returns the bytes of a range of addresses, if the image has them all.
    #[must_use]
    pub fn bytes(&self, start: u32, end: u32) -> Option<&[u8]> {
        self.segments.iter().find_map(|(from, bytes)| {
            let at = start.checked_sub(*from)? as usize;
            bytes.get(at..at + (end - start) as usize)
        })
    }

    /// Returns the word at an address of the flash: one that no program changes.
    #[must_use]
    pub(crate) fn flash_word(&self, at: u32) -> Option<u32> {
        let bytes = self.bytes(at, at.checked_add(4)?)?;
        let is_flash = (0x0800_0000..0x0810_0000).contains(&at);
        is_flash.then(|| u32::from_le_bytes(bytes.try_into().expect("four bytes")))
    }

    /// Returns where an address comes from: the place itself, then those that it was inlined into.
    #[must_use]
    pub(crate) fn source_frames(&self, at: u32) -> Vec<SourceFrame> {
        let mut places = Vec::new();
        let Some(source) = &self.source else { return places };
        let Ok(mut frames) = source.find_frames(at.into()).skip_all_loads() else { return places };
        while let Ok(Some(frame)) = frames.next() {
            let name = frame.function.as_ref().and_then(|name| name.demangle().ok());
            let function = name.map(|name| strip_symbol_hash(&name)).unwrap_or_default();
            let file =
                frame.location.as_ref().and_then(|location| location.file).unwrap_or_default();
            let line =
                frame.location.as_ref().and_then(|location| location.line).unwrap_or_default();
            places.push(SourceFrame { function, file: file.to_owned(), line });
        }
        places
    }
}

/// Takes the hash of the compiler off a name.
fn strip_symbol_hash(name: &str) -> String {
    let cut = name.rsplit_once("::h").filter(|(_, hash)| {
        hash.len() == 16 && hash.chars().all(|digit| digit.is_ascii_hexdigit())
    });
    cut.map_or(name, |(name, _)| name).to_owned()
}
