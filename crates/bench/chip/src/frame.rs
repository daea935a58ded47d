//! A frame on the CAN bus: its length on the wire with stuff bits, its rank in arbitration (ISO 11898-1),
//! and the protection that both ends of this link use (AUTOSAR E2E profile 5).

/// The lower 18 bits of an extended identifier, which follow the flag of the extension.
const ID_EXTENSION_MASK: u32 = 0x3ffff;
/// The 15 bits of the checksum of a frame.
const CRC15_MASK: u32 = 0x7fff;
/// The generator polynomial of the checksum of a frame.
const CRC15_POLYNOMIAL: u32 = 0x4599;
/// CRC-16/CCITT-FALSE: the start value.
const E2E_CRC_INITIAL_VALUE: u16 = 0xffff;
/// CRC-16/CCITT-FALSE: the highest bit.
const E2E_CRC_TOP_BIT_MASK: u16 = 0x8000;
/// CRC-16/CCITT-FALSE: the generator polynomial.
const E2E_CRC_POLYNOMIAL: u16 = 0x1021;

/// A frame on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// Its identifier.
    pub id: u32,
    /// The identifier has 29 bits instead of 11.
    pub ext: bool,
    /// It is a remote frame, without data.
    pub rtr: bool,
    /// The number of its bytes, as DLC.
    pub len: u8,
    /// Its bytes; those from `len` on are 0.
    pub data: [u8; 8],
}

impl CanFrame {
    /// Returns a data frame with an identifier of 11 bits and at most eight bytes.
    pub fn new(id: u32, data: &[u8]) -> CanFrame {
        let mut d = [0; 8];
        d[..data.len()].copy_from_slice(data);
        CanFrame { id, ext: false, rtr: false, len: data.len() as u8, data: d }
    }
    /// Returns what decides on the bus: the lower goes first.
    pub fn arbitration_key(&self) -> u64 {
        let (id, ext) = (u64::from(self.id), u64::from(self.ext));
        if self.ext {
            (id >> 18) << 21
                | 3 << 19
                | (id & u64::from(ID_EXTENSION_MASK)) << 1
                | u64::from(self.rtr)
        } else {
            id << 21 | u64::from(self.rtr) << 20 | ext
        }
    }
    /// Bits on the wire, from the start bit through the three of the pause.
    pub fn bit_length(&self) -> u64 {
        let mut raw: Vec<bool> = Vec::with_capacity(128);
        let mut put = |v: u32, n: u32| raw.extend((0..n).rev().map(|i| v >> i & 1 != 0));
        put(0, 1);
        if self.ext {
            put(self.id >> 18, 11);
            put(3, 2);
            put(self.id & ID_EXTENSION_MASK, 18);
            put(u32::from(self.rtr) << 2, 3);
        } else {
            put(self.id, 11);
            put(u32::from(self.rtr) << 2, 3);
        }
        put(u32::from(self.len.min(15)), 4);
        if !self.rtr {
            for b in &self.data[..self.len.min(8) as usize] {
                put(u32::from(*b), 8);
            }
        }
        let mut crc = 0u32;
        for b in &raw {
            let next = *b ^ (crc >> 14 & 1 != 0);
            crc = crc << 1 & CRC15_MASK;
            if next {
                crc ^= CRC15_POLYNOMIAL;
            }
        }
        raw.extend((0..15).rev().map(|i| crc >> i & 1 != 0));
        let (mut stuffed, mut run, mut last) = (0, 0, None);
        for b in &raw {
            if Some(*b) == last {
                run += 1
            } else {
                run = 1;
                last = Some(*b)
            }
            if run == 5 {
                stuffed += 1;
                last = Some(!*b);
                run = 1;
            }
        }
        // CRC delimiter, ACK and its delimiter, end of frame, pause.
        raw.len() as u64 + stuffed + 3 + 7 + 3
    }
}

/// AUTOSAR E2E profile 5: CRC-16/CCITT-FALSE over byte 2 to the end, then the data ID.
pub fn compute_e2e_crc(id: u32, data: &[u8]) -> u16 {
    let mut crc = E2E_CRC_INITIAL_VALUE;
    for b in data[2..].iter().copied().chain([id as u8, (id >> 8) as u8]) {
        crc ^= u16::from(b) << 8;
        for _ in 0..8 {
            crc = if crc & E2E_CRC_TOP_BIT_MASK != 0 {
                crc << 1 ^ E2E_CRC_POLYNOMIAL
            } else {
                crc << 1
            };
        }
    }
    crc
}

/// Returns a protected frame: checksum, counter, and a body of at most five bytes.
pub fn build_protected_frame(id: u32, counter: u8, body: &[u8]) -> CanFrame {
    let mut d = [0u8; 8];
    d[2] = counter;
    d[3..3 + body.len()].copy_from_slice(body);
    let c = compute_e2e_crc(id, &d).to_le_bytes();
    d[..2].copy_from_slice(&c);
    CanFrame::new(id, &d)
}
