//! Loads the segments of a 32-bit little-endian ELF file by their load addresses, and looks up symbols.

fn u16_at(b: &[u8], o: usize) -> u16 {
    u16::from_le_bytes(b[o..o + 2].try_into().unwrap())
}
fn u32_at(b: &[u8], o: usize) -> u32 {
    u32::from_le_bytes(b[o..o + 4].try_into().unwrap())
}

/// Returns what is placed in memory: (address, bytes).
pub fn parse_loadable_segments(b: &[u8]) -> Vec<(u32, Vec<u8>)> {
    assert_eq!(&b[..5], b"\x7fELF\x01", "not a 32-bit ELF file");
    assert_eq!(u16_at(b, 18), 40, "not an Arm image");
    let (off, size, n) = (u32_at(b, 28) as usize, u16_at(b, 42) as usize, u16_at(b, 44) as usize);
    let mut out = Vec::new();
    for i in 0..n {
        let p = off + i * size;
        let (kind, from, paddr, len) = (
            u32_at(b, p),
            u32_at(b, p + 4) as usize,
            u32_at(b, p + 12),
            u32_at(b, p + 16) as usize,
        );
        if kind == 1 && len > 0 {
            out.push((paddr, b[from..from + len].to_vec()));
        }
    }
    out
}

/// Functions and objects by address, and one by its name.
pub struct SymbolTable(Vec<(u32, u32, String)>);

impl SymbolTable {
    /// Reads the symbols of an ELF file.
    pub fn parse(b: &[u8]) -> SymbolTable {
        let (off, size, n) =
            (u32_at(b, 32) as usize, u16_at(b, 46) as usize, u16_at(b, 48) as usize);
        let mut all = Vec::new();
        for i in 0..n {
            let s = off + i * size;
            if u32_at(b, s + 4) != 2 {
                continue;
            }
            let (at, len, link) = (
                u32_at(b, s + 16) as usize,
                u32_at(b, s + 20) as usize,
                u32_at(b, s + 24) as usize,
            );
            let names = u32_at(b, off + link * size + 16) as usize;
            for e in (at..at + len).step_by(16) {
                let name = names + u32_at(b, e) as usize;
                let end = name + b[name..].iter().position(|c| *c == 0).unwrap();
                let kind = b[e + 12] & 15;
                if kind == 1 || kind == 2 {
                    all.push((
                        u32_at(b, e + 4) & !1,
                        u32_at(b, e + 8),
                        String::from_utf8_lossy(&b[name..end]).into_owned(),
                    ));
                }
            }
        }
        all.sort();
        SymbolTable(all)
    }
    /// Returns the function at an address and the offset in it, or the address itself.
    pub fn describe_address(&self, pc: u32) -> String {
        let i = self.0.partition_point(|(a, _, _)| *a <= pc);
        match i.checked_sub(1).map(|i| &self.0[i]) {
            Some((a, len, name)) if pc < a + (*len).max(2) => {
                format!("{} + {:#x}", demangle(name), pc - a)
            }
            _ => format!("{pc:#010x}"),
        }
    }
    /// Returns the address of the symbol of that name.
    pub fn find_address(&self, name: &str) -> Option<u32> {
        self.0.iter().find(|(_, _, n)| n == name).map(|(a, _, _)| *a)
    }
}

/// `_ZN…17h0123456789abcdefE` without its hash, its lengths turned to `::`.
fn demangle(name: &str) -> String {
    let Some(mut rest) = name.strip_prefix("_ZN") else { return name.to_owned() };
    let mut parts = Vec::new();
    while let Some(d) = rest.find(|c: char| !c.is_ascii_digit()) {
        let Ok(len) = rest[..d].parse::<usize>() else { break };
        if d + len > rest.len() {
            break;
        }
        parts.push(&rest[d..d + len]);
        rest = &rest[d + len..];
    }
    if parts.last().is_some_and(|p| p.starts_with('h') && p.len() == 17) {
        parts.pop();
    }
    if parts.is_empty() { name.to_owned() } else { parts.join("::") }
}
