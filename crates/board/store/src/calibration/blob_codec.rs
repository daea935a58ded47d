//! How fields lie in a blob: one after the other, each written and read by its type.
//!
//! A field of fixed size lies where it stands. A table lies behind the fixed part and all tables
//! before it; where it stands there is a reference, `u16` offset and `u16` number of records.

use super::{blob_format::FIXED_PART_SIZE, error::BlobError};

/// A type that can be a field: written and read alike.
pub(super) trait Field<'b>: Sized {
    /// Bytes where it stands, its tables aside.
    const SIZE: usize;

    fn write(&self, to: &mut Writer<'_>);

    /// Refuses what has no meaning ([`Reader::reject`]), and goes on with another value.
    fn read(from: &mut Reader<'b>) -> Self;
}

/// Makes fields of types that are one number.
macro_rules! numbers {
    ($($type:ty: $number:ty),* $(,)?) => {$(
        impl<'b> $crate::calibration::blob_codec::Field<'b> for $type {
            const SIZE: usize = <$number as $crate::calibration::blob_codec::Field<'b>>::SIZE;

            fn write(&self, to: &mut $crate::calibration::blob_codec::Writer<'_>) {
                self.0.write(to);
            }

            fn read(from: &mut $crate::calibration::blob_codec::Reader<'b>) -> Self {
                Self(<$number>::read(from))
            }
        }
    )*};
}

/// Makes a field of a type whose fields lie in this order.
macro_rules! fields {
    ($type:ty { $($field:ident: $kind:ty),* $(,)? }) => {
        impl<'b> $crate::calibration::blob_codec::Field<'b> for $type {
            const SIZE: usize =
                0_usize$(.saturating_add(<$kind as $crate::calibration::blob_codec::Field<'b>>::SIZE))*;

            fn write(&self, to: &mut $crate::calibration::blob_codec::Writer<'_>) {
                $(self.$field.write(to);)*
            }

            fn read(from: &mut $crate::calibration::blob_codec::Reader<'b>) -> Self {
                Self { $($field: <$kind>::read(from)),* }
            }
        }
    };
}

/// Declares a record: a type, and its fields in the order in which they lie.
macro_rules! record {
    ($(#[$doc:meta])* $name:ident<$life:lifetime> {
        $($(#[$field_doc:meta])* $field:ident: $kind:ty,)*
    }) => {
        $(#[$doc])*
        pub(super) struct $name<$life> {
            $($(#[$field_doc])* pub $field: $kind,)*
        }

        $crate::calibration::blob_codec::fields!($name<$life> { $($field: $kind),* });
    };
}

pub(super) use {fields, numbers, record};

/// Fills the fixed part from `at` on, and puts each table behind the last one. Bytes that do not fit are
/// counted, not written.
pub(super) struct Writer<'o> {
    out: &'o mut [u8],
    at: usize,
    tables_end: usize,
    /// Where the present term begins.
    pub term: usize,
}

impl<'o> Writer<'o> {
    pub fn new(out: &'o mut [u8]) -> Self {
        Self { out, at: 0, tables_end: FIXED_PART_SIZE, term: 0 }
    }

    pub(crate) fn write_bytes(&mut self, bytes: &[u8]) {
        let end = self.at.saturating_add(bytes.len());
        if let Some(place) = self.out.get_mut(self.at..end) {
            place.copy_from_slice(bytes);
        }
        self.at = end;
    }

    /// A byte in the head of the present term.
    pub(crate) fn write_term_byte(&mut self, number: usize, byte: u8) {
        if let Some(place) = self.out.get_mut(self.term.saturating_add(number)) {
            *place = byte;
        }
    }

    /// Writes a reference to a table, and the table. Returns where that begins.
    pub(crate) fn write_table<const N: usize>(&mut self, records: &[[u8; N]]) -> usize {
        let start = self.tables_end;
        // A place or a number beyond 16 bits is beyond the largest blob, which is refused.
        let place = u16::try_from(start).unwrap_or(u16::MAX);
        let count = u16::try_from(records.len()).unwrap_or(u16::MAX);
        self.write_bytes(&(if count == 0 { 0 } else { place }).to_le_bytes());
        self.write_bytes(&count.to_le_bytes());
        self.write_at(start, |to| to.write_bytes(records.as_flattened()));
        self.tables_end = start.saturating_add(records.as_flattened().len());
        start
    }

    /// Writes at another place, and goes on here.
    pub(crate) fn write_at(&mut self, at: usize, write: impl FnOnce(&mut Self)) {
        let here = core::mem::replace(&mut self.at, at);
        write(self);
        self.at = here;
    }

    /// Where the last table ends.
    pub(crate) const fn tables_end(&self) -> usize {
        self.tables_end
    }

    pub fn finish(self) -> &'o mut [u8] {
        self.out
    }
}

/// Reads the fixed part from `at` on, to its end, whatever is found there: the first fault is kept
/// until [`Self::finish`]. (An early return from every field costs the board 4 KB of code.)
pub(super) struct Reader<'b> {
    blob: &'b [u8],
    pub at: usize,
    /// Where the present term begins.
    pub term: usize,
    fault: Option<BlobError>,
}

impl<'b> Reader<'b> {
    /// Reads a blob without its CRC.
    pub const fn new(blob: &'b [u8], at: usize) -> Self {
        Self { blob, at, term: 0, fault: None }
    }

    /// Refuses the blob for this, unless it is refused already.
    pub(crate) fn reject(&mut self, fault: BlobError) {
        self.fault.get_or_insert(fault);
    }

    /// Refuses a number that stands for nothing.
    pub(crate) fn reject_value<T>(&mut self, offset: usize, found: impl Into<u32>) -> Option<T> {
        self.reject(BlobError::Value { offset, found: found.into() });
        None
    }

    /// Returns a cap in the four bytes that were read last, at most `most`.
    #[inline(never)]
    pub(crate) fn check_limit(&mut self, found: u8, most: u8) -> u8 {
        if found > most {
            let offset = self.at.saturating_sub(4);
            self.reject(BlobError::Limit { offset, found: found.into(), most: most.into() });
        }
        found
    }

    /// Gives what was read, if nothing was refused.
    pub fn finish<T>(self, read: T) -> Result<T, BlobError> {
        self.fault.map_or(Ok(read), Err)
    }

    /// Returns the next four bytes. The fixed part is there: its length was checked.
    #[inline(never)]
    pub fn read_bytes(&mut self) -> [u8; 4] {
        let rest = self.blob.get(self.at..).unwrap_or_default();
        self.at = self.at.saturating_add(4);
        rest.first_chunk().copied().unwrap_or_default()
    }

    /// Returns a byte in the head of the present term.
    pub(crate) fn read_term_byte(&self, number: usize) -> u8 {
        self.blob.get(self.term.saturating_add(number)).copied().unwrap_or_default()
    }

    /// Returns the table that the next reference names.
    pub(crate) fn read_records<const N: usize>(&mut self) -> &'b [[u8; N]] {
        self.read_table(N).as_chunks().0
    }

    /// Returns the bytes of the table of records of `size` bytes that the next reference names.
    #[inline(never)]
    fn read_table(&mut self, size: usize) -> &'b [u8] {
        let offset = self.at;
        let [o0, o1, n0, n1] = self.read_bytes();
        let start = usize::from(u16::from_le_bytes([o0, o1]));
        let bytes = usize::from(u16::from_le_bytes([n0, n1])).saturating_mul(size);
        if bytes == 0 {
            return &[];
        }
        let table = self.blob.get(start..start.saturating_add(bytes));
        table.filter(|_| start >= FIXED_PART_SIZE).unwrap_or_else(|| {
            self.reject(BlobError::Table { offset });
            &[]
        })
    }

    /// Reads at another place, and goes on here.
    pub(crate) fn read_at<T>(&mut self, at: usize, read: impl FnOnce(&mut Self) -> T) -> T {
        let here = core::mem::replace(&mut self.at, at);
        let result = read(self);
        self.at = here;
        result
    }
}

impl<'b> Field<'b> for u32 {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_bytes(&self.to_le_bytes());
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self::from_le_bytes(from.read_bytes())
    }
}

impl<'b> Field<'b> for i32 {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_bytes(&self.to_le_bytes());
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self::from_le_bytes(from.read_bytes())
    }
}

/// The low word first.
impl<'b> Field<'b> for u64 {
    const SIZE: usize = 8;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_bytes(&self.to_le_bytes());
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let (low, high) = (u32::read(from), u32::read(from));
        Self::from(high) << 32 | Self::from(low)
    }
}

impl<'b, T: Field<'b>, const N: usize> Field<'b> for [T; N] {
    const SIZE: usize = N.saturating_mul(T::SIZE);

    fn write(&self, to: &mut Writer<'_>) {
        self.iter().for_each(|field| field.write(to));
    }

    fn read(from: &mut Reader<'b>) -> Self {
        core::array::from_fn(|_| T::read(from))
    }
}
