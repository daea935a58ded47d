//! The calibration as the host sends it and the board stores it: one blob, little-endian, read in
//! place.
//!
//! A fixed part of [`FIXED_SIZE`] bytes, the tables that it refers to, and a CRC. A table is given by
//! a reference: `u16` offset from the start of the blob, `u16` number of records.
//!
//! | offset | field | unit |
//! |---|---|---|
//! | 0 | magic `TRUP`; `u16` schema 3; `u16` length of all of the blob in bytes | |
//! | 8 | 3 × `i32` largest offset on X, Y, Z | nm, 0…5 242 870 |
//! | 20 | `u32` slew limit; `u32` link timeout; `u32` hold | nm/s; ms |
//! | 32 | 3 × `i32` tool direction at angles 0 | 2⁻³⁰, together a unit vector |
//! | 44 | 4 × `u8`: first and second axis that turn the tool (1, 2, 3: A, B, C), 0, 0 | |
//! | 48 | 4 × `u8`: sources of the elongation in their order (1 sensor, 2 temperature, 3 warm-up), 0 | |
//! | 52 | `i32` K₀, V₀, tanβ of the sensor | nm; 1/1024 code; 2⁻²⁸ nm per 1/1024 code |
//! | 64 | `u32` channel, `u32` smoothing factor, law of the spindle's temperature | |
//! | 76 | `u32` lag, `i32` largest (1/256 nm), 2 × `u32` smoothing factors, `i32` 1/(1 − e⁻ᵏ) of the warm-up; its power curve | |
//! | 112 | 8 × temperature channel: `u8` kind (1 PT100, 2 linear), `u8` shift, 0, 0; `i32` zero, `i32` slope | |
//! | 208 | 3 × linear axis, 80 bytes each | |
//! | 448 | 6 × straightness curve, 16 bytes each, in the order of [`AXIS_PAIRS`](trueup_core::calibration::AXIS_PAIRS) | |
//! | 544 | 6 × `i32` squareness, in the same order | 2⁻³⁶ nm per 10 nm |
//! | 568 | `u32` smoothing factor of the spindle's temperature while it falls | |
//! | 572 | terms of a diagnosis: a table of 24 bytes each | |
//! | 576 | the tables, each record on a multiple of 2 bytes | |
//! | length − 4 | CRC-32/AUTOSAR of all bytes before it | |
//!
//! A linear axis: `u32` channel (255: none), `u32` smoothing factor, `i32` origin, law; pitch: `i32` start,
//! `u32` step, forward, reverse; second drive: `u32` axis across (255: none), `i32` first, `i32`
//! second, `i32` start, `u32` step, forward, reverse; `i32` backlash, `u32` hysteresis, `u32` ramp;
//! `u32` smoothing factor while it falls; 4 bytes of 0. A curve: segments, index, `i32` first knot, `u32` bucket shift. A law is a reference to
//! [pieces](trueup_core::thermal), a pitch table one to `i32` in 1/256 nm.
//!
//! A term: `u8` kind, `u8` target (0 elongation, 1, 2, 3: X, Y, Z), `u8` channel or axis, `u8` binary
//! places of the coefficient; `i32` constant (1/256 nm); four words:
//!
//! | kind | words |
//! |---|---|
//! | 0 offset | none |
//! | 1 gain, 2 curvature, 6 speed, 7 load | `i32` coefficient |
//! | 3 saturation | `i32` limit |
//! | 4 heat | `i32` coefficient, `u32` smoothing factor, `i32` reference |
//! | 5 time | `i32` coefficient, `u32` smoothing factor |
//! | 8 position | `i32` gradient |
//! | 9 reversed | `i32` width, `i32` gradient |
//! | 10 table | as a pitch |
//! | 11 curve | as a curve |
//! | 12 wave | `i32` amplitude, `u32` phase, `u64` turns |
//!
//! The checks go from the outside in: a blob of another schema is told apart from a damaged one
//! before the CRC is looked at, because its CRC may lie elsewhere. After that every reference, range
//! and table is checked once, so that the tick can rely on them.

use core::{error::Error, fmt};

use trueup_core::{
    calibration::{
        AxisModel, AxisThermal, Calibration, Dual, ElongationSource, SpindleModel,
        SpindleTemperature, SpindleWarmup,
    },
    cnc::LinearAxis,
    curve::Curve,
    dimensions::CHANNELS,
    dimensions::MAX_TERMS,
    fixed::Scaled,
    gradient::Gradient,
    kinematics::{self, Kinematics},
    lag::SmoothingFactor,
    limits::Limits,
    pitch::{Beam, Pitch},
    sensor::{SensorLaw, Slope},
    term::{Effect, Target, Term},
    thermal::Law,
    thermometer::Thermometer,
    tool::Direction,
    travel::{self, Interval},
    units::{Fine, Nanometres, Position, Reading, Temperature},
    warmup,
};

use trueup_link::layout::{NANOMETRES_PER_BIT, OFFSET_MAX_RAW};

use crate::crc;

/// Bytes of the fixed part.
pub const FIXED_SIZE: usize = 576;
/// The largest blob: a slot of the board's flash.
pub const MAX_SIZE: usize = 16_384;
/// The first four bytes.
pub const MAGIC: [u8; 4] = *b"TRUP";
/// The layout described here.
pub const SCHEMA: u16 = 3;
/// The largest offset that the frames to the CNC can carry, in nanometres.
pub const MAX_OFFSET_NM: i32 = OFFSET_MAX_RAW * NANOMETRES_PER_BIT;

/// Bytes of the CRC, at the end.
const CRC_SIZE: usize = 4;
const MAX_OFFSETS: usize = 8;
const DIRECTION_OFFSET: usize = 32;
/// In place of a number of a channel or of an axis: there is none.
const NONE: u32 = 255;

/// How far the square of the tool direction's length may be from 1, in 2⁻⁶⁰: 2⁻¹⁹. The length is
/// then right to 10⁻⁶, 1 nm of a millimetre; rounding to 2⁻³⁰ alone makes 2·10⁻⁹.
const UNIT_TOLERANCE: u64 = 1 << 41;

/// Writes the blob of a calibration, also of one that [`decode`] would refuse; gives its bytes.
///
/// # Errors
/// [`TooLarge`]: it does not fit `out` (or [`MAX_SIZE`]).
pub fn encode<'o>(calibration: &Calibration<'_>, out: &'o mut [u8]) -> Result<&'o [u8], TooLarge> {
    let room = out.len().min(MAX_SIZE);
    let mut to = Writer { out, at: 0, tables_end: FIXED_SIZE };
    let Calibration {
        thermometers,
        spindle,
        kinematics,
        axes,
        straightness,
        squareness,
        terms,
        limits,
    } = calibration;
    to.bytes(&MAGIC);
    // The length is known at the end.
    to.word(0);
    limits.max.iter().for_each(|max| to.signed(max.0));
    to.word(limits.slew_nm_per_s);
    to.word(limits.link_timeout_ms);
    to.word(limits.hold_ms);
    kinematics.zero.0.iter().for_each(|component| to.signed(*component));
    let [first, second] = kinematics.axes.map(number_of_rotary_axis);
    to.bytes(&[first, second, 0, 0]);
    let [first, second, third] = spindle.chain.map(number_of_source);
    to.bytes(&[first, second, third, 0]);
    write_spindle(&mut to, spindle);
    for thermometer in thermometers {
        let (kind, shift, zero, slope) = match thermometer {
            None => (0, 0, 0, 0),
            Some(Thermometer::Pt100) => (1, 0, 0, 0),
            Some(Thermometer::Linear { zero, slope, shift }) => (2, *shift, *zero, *slope),
        };
        to.bytes(&[kind, shift, 0, 0]);
        to.signed(zero);
        to.signed(slope);
    }
    axes.iter().for_each(|axis| write_axis(&mut to, axis));
    for curve in straightness {
        write_curve(&mut to, curve);
    }
    squareness.iter().for_each(|gradient| to.signed(gradient.0));
    to.word(spindle.temperature.map_or(0, |it| it.smoothing_falling.0));
    write_terms(&mut to, terms);

    let end = to.tables_end.saturating_add(CRC_SIZE);
    let (true, Ok(length)) = (end <= room, u16::try_from(end)) else {
        return Err(TooLarge { bytes: end });
    };
    let [schema_low, schema_high] = SCHEMA.to_le_bytes();
    let [length_low, length_high] = length.to_le_bytes();
    to.at = MAGIC.len();
    to.bytes(&[schema_low, schema_high, length_low, length_high]);
    to.at = to.tables_end;
    let crc = crc::checksum(to.out.get(..to.tables_end).unwrap_or_default());
    to.word(crc);
    let out: &'o [u8] = to.out;
    out.get(..end).ok_or(TooLarge { bytes: end })
}

fn write_spindle(to: &mut Writer<'_>, spindle: &SpindleModel<'_>) {
    let SpindleModel { chain: _, sensor, temperature, warmup } = spindle;
    to.signed(sensor.k0.0);
    to.signed(sensor.zero.0);
    to.signed(sensor.slope.0);
    let (channel, smoothing, law) = match temperature {
        None => (NONE, SmoothingFactor(0), Law { pieces: &[] }),
        Some(SpindleTemperature { channel, smoothing, law, smoothing_falling: _ }) => {
            ((*channel).into(), *smoothing, *law)
        }
    };
    to.word(channel);
    to.word(smoothing.0);
    to.table(law.pieces);
    match warmup {
        None => {
            (0..5).for_each(|_| to.word(0));
            write_curve(to, &Curve::default());
        }
        Some(SpindleWarmup { law, power }) => {
            to.word(law.lag_ms);
            to.signed(law.max.0);
            to.word(law.smoothing_heating.0);
            to.word(law.smoothing_cooling.0);
            to.signed(law.full);
            write_curve(to, power);
        }
    }
}

fn write_axis(to: &mut Writer<'_>, axis: &AxisModel<'_>) {
    let AxisModel { thermal, pitch, dual, backlash, travel } = axis;
    let end = to.at.saturating_add(AXIS_SIZE);
    match thermal {
        None => {
            to.word(NONE);
            (0..3).for_each(|_| to.word(0));
        }
        Some(AxisThermal { channel, smoothing, origin, law, smoothing_falling: _ }) => {
            to.word((*channel).into());
            to.word(smoothing.0);
            to.signed(origin.0);
            to.table(law.pieces);
        }
    }
    write_pitch(to, pitch.as_ref());
    match dual {
        None => {
            to.word(NONE);
            (0..2).for_each(|_| to.word(0));
        }
        Some(Dual { across, beam, .. }) => {
            to.word(*across as u32);
            beam.drives().iter().for_each(|drive| to.signed(drive.0));
        }
    }
    write_pitch(to, dual.as_ref().map(|dual| &dual.pitch));
    to.signed(backlash.0);
    to.word(travel.hysteresis);
    to.word(travel.ramp.length());
    to.word(thermal.map_or(0, |thermal| thermal.smoothing_falling.0));
    while to.at < end {
        to.word(0);
    }
}

fn write_pitch(to: &mut Writer<'_>, pitch: Option<&Pitch<'_>>) {
    match pitch {
        None => (0..4).for_each(|_| to.word(0)),
        Some(pitch) => {
            to.signed(pitch.start.0);
            to.word(pitch.step.length());
            to.table(pitch.forward);
            to.table(pitch.reverse.unwrap_or_default());
        }
    }
}

fn write_curve(to: &mut Writer<'_>, curve: &Curve<'_>) {
    to.table(curve.segments());
    to.table(curve.index());
    to.signed(curve.first().0);
    to.word(curve.bucket_shift().into());
}

/// Bytes of a term.
const TERM_SIZE: usize = 24;

/// A reference to the terms, and the terms; what they refer to follows.
fn write_terms(to: &mut Writer<'_>, terms: &[Option<Term<'_>>]) {
    let next = to.at.saturating_add(4);
    // Room first: the tables of the terms come behind all of them.
    let count = terms.iter().flatten().count();
    let records = [[0_u8; TERM_SIZE]; MAX_TERMS];
    let start = to.tables_end;
    to.table(records.get(..count).unwrap_or_default());
    for (index, term) in terms.iter().flatten().enumerate() {
        to.at = start.saturating_add(index.saturating_mul(TERM_SIZE));
        write_term(to, term);
    }
    to.at = next;
}

fn write_term(to: &mut Writer<'_>, term: &Term<'_>) {
    let target = match term.target {
        Target::Elongation => 0,
        Target::Axis(LinearAxis::X) => 1,
        Target::Axis(LinearAxis::Y) => 2,
        Target::Axis(LinearAxis::Z) => 3,
    };
    let mut head = |kind: u8, input: u8, scaled: Scaled| {
        to.bytes(&[kind, target, input, scaled.shift]);
        to.signed(term.constant.0);
    };
    let of_axis = |axis: LinearAxis| axis as u8;
    let none = Scaled::default();
    match term.effect {
        Effect::Offset => head(0, 0, none),
        Effect::Gain(scaled)
        | Effect::Curvature(scaled)
        | Effect::Speed(scaled)
        | Effect::Load(scaled) => {
            let kind = match term.effect {
                Effect::Gain(_) => 1,
                Effect::Curvature(_) => 2,
                Effect::Speed(_) => 6,
                _ => 7,
            };
            head(kind, 0, scaled);
            to.signed(scaled.mantissa);
        }
        Effect::Saturation(limit) => {
            head(3, 0, none);
            to.signed(limit.0);
        }
        Effect::Heat { channel, smoothing, reference, per_temperature } => {
            head(4, channel, per_temperature);
            to.signed(per_temperature.mantissa);
            to.word(smoothing.0);
            to.signed(reference.0);
        }
        Effect::Time { smoothing, amplitude } => {
            head(5, 0, amplitude);
            to.signed(amplitude.mantissa);
            to.word(smoothing.0);
        }
        Effect::Position { axis, gradient } => {
            head(8, of_axis(axis), none);
            to.signed(gradient.0);
        }
        Effect::Reversed { width, gradient } => {
            head(9, 0, none);
            to.signed(width.0);
            to.signed(gradient.0);
        }
        Effect::Table(pitch) => {
            head(10, 0, none);
            write_pitch(to, Some(&pitch));
        }
        Effect::Curve { axis, curve } => {
            head(11, of_axis(axis), none);
            write_curve(to, &curve);
        }
        Effect::Wave { turns, phase, amplitude } => {
            head(12, 0, none);
            to.signed(amplitude.0);
            to.word(phase);
            to.bytes(&turns.to_le_bytes());
        }
    }
}

/// Bytes of a linear axis.
const AXIS_SIZE: usize = 80;

/// Fills the fixed part from `at` on, and puts each table behind the last one. What does not fit is
/// counted, not written.
struct Writer<'o> {
    out: &'o mut [u8],
    at: usize,
    tables_end: usize,
}

impl Writer<'_> {
    fn bytes(&mut self, bytes: &[u8]) {
        let end = self.at.saturating_add(bytes.len());
        if let Some(place) = self.out.get_mut(self.at..end) {
            place.copy_from_slice(bytes);
        }
        self.at = end;
    }

    fn word(&mut self, word: u32) {
        self.bytes(&word.to_le_bytes());
    }

    fn signed(&mut self, word: i32) {
        self.bytes(&word.to_le_bytes());
    }

    /// A reference to a table, and the table.
    fn table<const N: usize>(&mut self, records: &[[u8; N]]) {
        let start = self.tables_end;
        let next = self.at.saturating_add(4);
        // A place or a number beyond 16 bits is beyond the largest blob, which is refused.
        let place = u16::try_from(start).unwrap_or(u16::MAX);
        let count = u16::try_from(records.len()).unwrap_or(u16::MAX);
        self.word((u32::from(count) << 16) | u32::from(if count == 0 { 0 } else { place }));
        self.at = start;
        self.bytes(records.as_flattened());
        self.tables_end = self.at;
        self.at = next;
    }
}

fn number_of_source(source: Option<ElongationSource>) -> u8 {
    match source {
        None => 0,
        Some(ElongationSource::Sensor) => 1,
        Some(ElongationSource::Temperature) => 2,
        Some(ElongationSource::Warmup) => 3,
    }
}

fn number_of_rotary_axis(axis: Option<kinematics::RotaryAxis>) -> u8 {
    match axis {
        None => 0,
        Some(kinematics::RotaryAxis::A) => 1,
        Some(kinematics::RotaryAxis::B) => 2,
        Some(kinematics::RotaryAxis::C) => 3,
    }
}

/// Why there is no blob: the calibration has more in it than a board can store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLarge {
    /// Bytes that it would have.
    pub bytes: usize,
}

impl fmt::Display for TooLarge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes do not fit the board's {MAX_SIZE}", self.bytes)
    }
}

impl Error for TooLarge {}

/// The bytes of the blob at the start of `bytes`, checked for being whole: what [`decode`] reads.
///
/// # Errors
/// As [`decode`].
pub fn whole(bytes: &[u8]) -> Result<&[u8], BlobError> {
    let too_short = BlobError::TooShort { len: bytes.len() };
    let &[m0, m1, m2, m3, schema_low, schema_high, length_low, length_high] =
        bytes.first_chunk().ok_or(too_short)?;
    let magic = [m0, m1, m2, m3];
    if magic != MAGIC {
        return Err(BlobError::Magic { found: magic });
    }
    let schema = u16::from_le_bytes([schema_low, schema_high]);
    if schema != SCHEMA {
        return Err(BlobError::Schema { found: schema });
    }
    let length = u16::from_le_bytes([length_low, length_high]);
    let least = FIXED_SIZE.saturating_add(CRC_SIZE);
    if !(least..=MAX_SIZE).contains(&length.into()) {
        return Err(BlobError::Length { found: length });
    }
    let blob = bytes.get(..length.into()).ok_or(too_short)?;
    let (content, crc) = blob.split_last_chunk().ok_or(too_short)?;
    let (stored, computed) = (u32::from_le_bytes(*crc), crc::checksum(content));
    if stored != computed {
        return Err(BlobError::Crc { stored, computed });
    }
    Ok(blob)
}

/// What tells one calibration from another: the CRC of its blob, whole as [`whole`] finds it.
#[must_use]
pub fn identity(whole: &[u8]) -> u32 {
    u32::from_le_bytes(*whole.last_chunk().unwrap_or(&[0; CRC_SIZE]))
}

/// The calibration in a blob; its tables stay where they are. Bytes after the blob are not looked
/// at, so that a whole slot of flash can be given.
///
/// # Errors
/// [`BlobError`] with the place and the value at fault; nothing of such a blob must be used.
pub fn decode(bytes: &[u8]) -> Result<Calibration<'_>, BlobError> {
    let blob = whole(bytes)?;
    let content = blob.get(..blob.len().saturating_sub(CRC_SIZE)).unwrap_or_default();
    let mut from = Reader { blob: content, at: MAX_OFFSETS };
    let mut max = [Nanometres::ZERO; 3];
    for max in &mut max {
        let offset = from.at;
        max.0 = from.signed();
        if !(0..=MAX_OFFSET_NM).contains(&max.0) {
            return Err(BlobError::MaxOffset { offset, found: max.0 });
        }
    }
    let limits = Limits {
        max,
        slew_nm_per_s: from.word(),
        link_timeout_ms: from.word(),
        hold_ms: from.word(),
    };
    let zero = direction([from.signed(), from.signed(), from.signed()])?;
    let [first, second, ..] = from.bytes();
    let kinematics = Kinematics { zero, axes: [from.rotary(first)?, from.rotary(second)?] };
    let mut spindle = read_spindle(&mut from)?;
    let mut thermometers = [None; CHANNELS];
    for thermometer in &mut thermometers {
        let offset = from.at;
        let ([kind, shift, ..], zero, slope) = (from.bytes(), from.signed(), from.signed());
        *thermometer = match kind {
            0 => None,
            1 => Some(Thermometer::Pt100),
            2 => Some(Thermometer::Linear { zero, slope, shift }),
            found => return Err(BlobError::Value { offset, found: found.into() }),
        };
    }
    let axes = [from.axis()?, from.axis()?, from.axis()?];
    let mut straightness = [Curve::default(); 6];
    for curve in &mut straightness {
        *curve = from.curve()?;
    }
    let squareness = core::array::from_fn(|_| Gradient(from.signed()));
    let smoothing_falling = SmoothingFactor(from.word());
    if let Some(temperature) = &mut spindle.temperature {
        temperature.smoothing_falling = smoothing_falling;
    }
    let terms = from.terms()?;
    Ok(Calibration {
        thermometers,
        spindle,
        kinematics,
        axes,
        straightness,
        squareness,
        terms,
        limits,
    })
}

fn read_spindle<'b>(from: &mut Reader<'b>) -> Result<SpindleModel<'b>, BlobError> {
    let offset = from.at;
    let [first, second, third, _] = from.bytes();
    let source = |number: u8| match number {
        0 => Ok(None),
        1 => Ok(Some(ElongationSource::Sensor)),
        2 => Ok(Some(ElongationSource::Temperature)),
        3 => Ok(Some(ElongationSource::Warmup)),
        found => Err(BlobError::Value { offset, found: found.into() }),
    };
    let chain = [source(first)?, source(second)?, source(third)?];
    let sensor = SensorLaw {
        k0: Nanometres(from.signed()),
        zero: Reading(from.signed()),
        slope: Slope(from.signed()),
    };
    let channel = from.channel()?;
    let smoothing = SmoothingFactor(from.word());
    let law = from.law()?;
    // The factor while it falls comes later.
    let smoothing_falling = smoothing;
    let temperature =
        channel.map(|channel| SpindleTemperature { channel, smoothing, smoothing_falling, law });
    let law = warmup::Warmup {
        lag_ms: from.word(),
        max: Fine(from.signed()),
        smoothing_heating: SmoothingFactor(from.word()),
        smoothing_cooling: SmoothingFactor(from.word()),
        full: from.signed(),
    };
    let power = from.curve()?;
    let warmup = (law.max != Fine::ZERO || chain.contains(&Some(ElongationSource::Warmup)))
        .then_some(SpindleWarmup { law, power });
    Ok(SpindleModel { chain, sensor, temperature, warmup })
}

/// Reads the fixed part from `at` on.
struct Reader<'b> {
    blob: &'b [u8],
    at: usize,
}

impl<'b> Reader<'b> {
    /// The next four bytes. The fixed part is there: its length was checked.
    fn bytes(&mut self) -> [u8; 4] {
        let rest = self.blob.get(self.at..).unwrap_or_default();
        self.at = self.at.saturating_add(4);
        rest.first_chunk().copied().unwrap_or_default()
    }

    fn word(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }

    fn signed(&mut self) -> i32 {
        i32::from_le_bytes(self.bytes())
    }

    /// The table that the next reference names.
    fn table<const N: usize>(&mut self) -> Result<&'b [[u8; N]], BlobError> {
        let offset = self.at;
        let [o0, o1, n0, n1] = self.bytes();
        let start = usize::from(u16::from_le_bytes([o0, o1]));
        let bytes = usize::from(u16::from_le_bytes([n0, n1])).saturating_mul(N);
        if bytes == 0 {
            return Ok(&[]);
        }
        let table = self
            .blob
            .get(start..start.saturating_add(bytes))
            .filter(|_| start >= FIXED_SIZE)
            .ok_or(BlobError::Table { offset })?;
        Ok(table.as_chunks().0)
    }

    fn channel(&mut self) -> Result<Option<u8>, BlobError> {
        let offset = self.at;
        match self.word() {
            NONE => Ok(None),
            found => match u8::try_from(found) {
                Ok(channel) if usize::from(channel) < CHANNELS => Ok(Some(channel)),
                _ => Err(BlobError::Value { offset, found }),
            },
        }
    }

    fn rotary(&self, number: u8) -> Result<Option<kinematics::RotaryAxis>, BlobError> {
        match number {
            0 => Ok(None),
            1 => Ok(Some(kinematics::RotaryAxis::A)),
            2 => Ok(Some(kinematics::RotaryAxis::B)),
            3 => Ok(Some(kinematics::RotaryAxis::C)),
            found => {
                Err(BlobError::Value { offset: self.at.saturating_sub(4), found: found.into() })
            }
        }
    }

    fn law(&mut self) -> Result<Law<'b>, BlobError> {
        Ok(Law { pieces: self.table()? })
    }

    fn curve(&mut self) -> Result<Curve<'b>, BlobError> {
        let offset = self.at;
        let segments = self.table()?;
        let index = self.table()?;
        let first = Position(self.signed());
        let found = self.word();
        let bucket_shift = u8::try_from(found).map_err(|_| BlobError::Value { offset, found })?;
        let curve = Curve::new(first, segments, index, bucket_shift);
        if curve.is_consistent() { Ok(curve) } else { Err(BlobError::Table { offset }) }
    }

    fn pitch(&mut self) -> Result<Option<Pitch<'b>>, BlobError> {
        let offset = self.at;
        let start = Position(self.signed());
        let step = self.word();
        let (forward, reverse) = (self.table()?, self.table()?);
        if forward.is_empty() {
            return Ok(None);
        }
        let reverse = (!reverse.is_empty()).then_some(reverse);
        let pitch = Pitch { start, step: Interval::new(step), forward, reverse };
        if pitch.is_consistent() { Ok(Some(pitch)) } else { Err(BlobError::Table { offset }) }
    }

    fn axis(&mut self) -> Result<AxisModel<'b>, BlobError> {
        let end = self.at.saturating_add(AXIS_SIZE);
        let channel = self.channel()?;
        let (smoothing, origin, law) =
            (SmoothingFactor(self.word()), Position(self.signed()), self.law()?);
        let pitch = self.pitch()?;
        let offset = self.at;
        let across = match self.word() {
            NONE => None,
            found => Some(linear_axis(found, offset)?),
        };
        let (first, second) = (Position(self.signed()), Position(self.signed()));
        let dual = across.zip(self.pitch()?);
        let beam = Beam::new(first, second);
        let dual = dual.map(|(across, pitch)| Dual { across, beam, pitch });
        let backlash = Fine(self.signed());
        let travel = travel::Config { hysteresis: self.word(), ramp: Interval::new(self.word()) };
        let smoothing_falling = SmoothingFactor(self.word());
        let thermal = channel.map(|channel| AxisThermal {
            channel,
            smoothing,
            smoothing_falling,
            origin,
            law,
        });
        self.at = end;
        Ok(AxisModel { thermal, pitch, dual, backlash, travel })
    }
}

impl<'b> Reader<'b> {
    fn terms(&mut self) -> Result<[Option<Term<'b>>; MAX_TERMS], BlobError> {
        let offset = self.at;
        let at = self.word() & 0xFFFF;
        self.at = offset;
        let records = self.table::<TERM_SIZE>()?;
        let next = self.at;
        if records.len() > MAX_TERMS {
            return Err(BlobError::Table { offset });
        }
        let mut terms = [None; MAX_TERMS];
        let mut at = usize::try_from(at).unwrap_or(usize::MAX);
        for (term, _) in terms.iter_mut().zip(records) {
            self.at = at;
            *term = Some(self.term()?);
            at = at.saturating_add(TERM_SIZE);
        }
        self.at = next;
        Ok(terms)
    }

    fn term(&mut self) -> Result<Term<'b>, BlobError> {
        let offset = self.at;
        let [kind, target, input, shift] = self.bytes();
        let value = |found: u8| BlobError::Value { offset, found: found.into() };
        let target = match target {
            0 => Target::Elongation,
            found @ 1..=3 => Target::Axis(linear_axis(u32::from(found.wrapping_sub(1)), offset)?),
            found => return Err(value(found)),
        };
        if shift > 62 {
            return Err(value(shift));
        }
        let constant = Fine(self.signed());
        let scaled = |from: &mut Self| Scaled { mantissa: from.signed(), shift };
        let effect = match kind {
            0 => Effect::Offset,
            1 => Effect::Gain(scaled(self)),
            2 => Effect::Curvature(scaled(self)),
            3 => Effect::Saturation(Fine(self.signed())),
            4 if usize::from(input) < CHANNELS => Effect::Heat {
                channel: input,
                per_temperature: scaled(self),
                smoothing: SmoothingFactor(self.word()),
                reference: Temperature(self.signed()),
            },
            5 => Effect::Time { amplitude: scaled(self), smoothing: SmoothingFactor(self.word()) },
            6 => Effect::Speed(scaled(self)),
            7 => Effect::Load(scaled(self)),
            8 => Effect::Position {
                axis: linear_axis(input.into(), offset)?,
                gradient: Gradient(self.signed()),
            },
            9 => Effect::Reversed { width: Fine(self.signed()), gradient: Gradient(self.signed()) },
            10 => Effect::Table(self.pitch()?.ok_or(BlobError::Table { offset })?),
            11 => Effect::Curve { axis: linear_axis(input.into(), offset)?, curve: self.curve()? },
            12 => {
                let (amplitude, phase) = (Fine(self.signed()), self.word());
                let (low, high) = (u64::from(self.word()), u64::from(self.word()));
                Effect::Wave { turns: (high << 32) | low, phase, amplitude }
            }
            found => return Err(value(found)),
        };
        Ok(Term { target, constant, effect })
    }
}

fn linear_axis(number: u32, offset: usize) -> Result<LinearAxis, BlobError> {
    match number {
        0 => Ok(LinearAxis::X),
        1 => Ok(LinearAxis::Y),
        2 => Ok(LinearAxis::Z),
        found => Err(BlobError::Value { offset, found }),
    }
}

fn direction(components: [i32; 3]) -> Result<Direction, BlobError> {
    const ONE_SQUARED: u64 = 1 << (2 * Direction::FRACTION_BITS);
    let squares = components.map(|it| u64::from(it.unsigned_abs()).saturating_pow(2));
    let length_squared = squares.into_iter().fold(0, u64::saturating_add);
    if length_squared.abs_diff(ONE_SQUARED) > UNIT_TOLERANCE {
        return Err(BlobError::NotUnit { offset: DIRECTION_OFFSET, found: components });
    }
    Ok(Direction(components))
}

/// Why a blob is no calibration. Offsets count bytes from the start of the blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlobError {
    /// Fewer bytes than the blob has.
    TooShort {
        /// Bytes given.
        len: usize,
    },
    /// No calibration at all, such as erased flash: the bytes at offset 0.
    Magic {
        /// The four bytes.
        found: [u8; 4],
    },
    /// Written by a host of another version: the number at offset 4.
    Schema {
        /// The schema of the blob.
        found: u16,
    },
    /// The stated length, at offset 6, is no length of a blob.
    Length {
        /// The stated length.
        found: u16,
    },
    /// Damaged: the CRC at the end does not fit.
    Crc {
        /// The CRC in the blob.
        stored: u32,
        /// The CRC over the blob.
        computed: u32,
    },
    /// The tool direction is not a unit vector.
    NotUnit {
        /// Offset of its first component.
        offset: usize,
        /// The components, in 2⁻³⁰.
        found: [i32; 3],
    },
    /// A largest offset is negative, or more than the frames to the CNC can carry.
    MaxOffset {
        /// Offset of the value.
        offset: usize,
        /// The value in nanometres.
        found: i32,
    },
    /// A number that stands for nothing: of a channel, an axis, a source.
    Value {
        /// Offset of the value.
        offset: usize,
        /// The value.
        found: u32,
    },
    /// A table that is not in the blob, or that contradicts itself.
    Table {
        /// Offset of its reference.
        offset: usize,
    },
}

impl fmt::Display for BlobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooShort { len } => write!(f, "{len} bytes are too short for the calibration"),
            Self::Magic { found } => {
                write!(f, "bytes {found:02X?} at 0 are not the mark {MAGIC:02X?} of a calibration")
            }
            Self::Schema { found } => write!(f, "schema {found} at 4 is not {SCHEMA}"),
            Self::Length { found } => {
                let least = FIXED_SIZE.saturating_add(CRC_SIZE);
                write!(f, "length {found} at 6 is not within {least}…{MAX_SIZE}")
            }
            Self::Crc { stored, computed } => {
                write!(f, "the CRC at the end is 0x{stored:08X}, should be 0x{computed:08X}")
            }
            Self::NotUnit { offset, found } => write!(
                f,
                "tool direction {found:?} at {offset} has not the length 1 ({})",
                Direction::ONE
            ),
            Self::MaxOffset { offset, found } => write!(
                f,
                "largest offset {found} nm at {offset} is not within 0…{MAX_OFFSET_NM} nm"
            ),
            Self::Value { offset, found } => write!(f, "{found} at {offset} has no meaning"),
            Self::Table { offset } => {
                write!(f, "the table named at {offset} is outside the blob or contradicts itself")
            }
        }
    }
}

impl Error for BlobError {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;
    use trueup_core::{curve::Segment, thermal::Piece};

    const POINTS: [[u8; 4]; 3] = [[1, 0, 0, 0], [2, 0, 0, 0], [3, 0, 0, 0]];

    /// A calibration with something in every field.
    fn with_sample<T>(check: impl FnOnce(Calibration<'_>) -> T) -> T {
        let piece = Piece {
            start: trueup_core::units::Temperature(94_208_000),
            constant: Fine(1),
            constant_slope: 2,
            gradient: Gradient(3),
            gradient_slope: 4,
        };
        let pieces = [piece.to_bytes()];
        let segments = [100_000, 131_071]
            .map(|end| Segment::new(Position(end), 15, [256, 0, 0, 0]).to_bytes());
        // The second segment begins after the start of the last of four buckets of 2¹⁵.
        let index = [[0, 0], [0, 0], [0, 0], [0, 0]];
        let curve = Curve::new(Position(0), &segments, &index, 15);
        let pitch = Pitch {
            start: Position(-5),
            step: Interval::new(1_000),
            forward: &POINTS,
            reverse: Some(&POINTS),
        };
        let axis = AxisModel {
            thermal: Some(AxisThermal {
                smoothing_falling: SmoothingFactor(8),
                channel: 2,
                smoothing: SmoothingFactor(7),
                origin: Position(-9),
                law: Law { pieces: &pieces },
            }),
            pitch: Some(pitch),
            dual: Some(Dual {
                across: LinearAxis::Y,
                beam: Beam::new(Position(1), Position(2)),
                pitch: Pitch { reverse: None, ..pitch },
            }),
            backlash: Fine(-77),
            travel: travel::Config { hysteresis: 100, ramp: Interval::new(5_000) },
        };
        let law = warmup::Warmup {
            lag_ms: 60_000,
            max: Fine(80_000),
            smoothing_heating: SmoothingFactor(5),
            smoothing_cooling: SmoothingFactor(6),
            full: 8,
        };
        let scaled = Scaled { mantissa: -7, shift: 11 };
        let x = Target::Axis(LinearAxis::X);
        let y = Target::Axis(LinearAxis::Y);
        let heat = Effect::Heat {
            channel: 7,
            smoothing: SmoothingFactor(21),
            reference: Temperature(-22),
            per_temperature: scaled,
        };
        let reversed = Effect::Reversed { width: Fine(4), gradient: Gradient(-5) };
        let wave = Effect::Wave { turns: 0x1234_5678_9ABC_DEF0, phase: 7, amplitude: Fine(-8) };
        let all = [
            (Target::Elongation, Effect::Offset),
            (Target::Elongation, Effect::Gain(scaled)),
            (Target::Elongation, Effect::Curvature(scaled)),
            (Target::Elongation, Effect::Saturation(Fine(9))),
            (y, heat),
            (Target::Elongation, Effect::Time { smoothing: SmoothingFactor(3), amplitude: scaled }),
            (Target::Elongation, Effect::Speed(scaled)),
            (Target::Elongation, Effect::Load(scaled)),
            (x, Effect::Position { axis: LinearAxis::Z, gradient: Gradient(-3) }),
            (x, reversed),
            (x, Effect::Table(pitch)),
            (x, Effect::Curve { axis: LinearAxis::Y, curve }),
            (Target::Axis(LinearAxis::Z), wave),
        ];
        let mut terms = [None; MAX_TERMS];
        for (place, (target, effect)) in terms.iter_mut().zip(all) {
            *place = Some(Term { target, constant: Fine(-6), effect });
        }
        check(Calibration {
            thermometers: core::array::from_fn(|n| match n {
                2 => Some(Thermometer::Pt100),
                5 => Some(Thermometer::Linear { zero: -3, slope: 4, shift: 7 }),
                _ => None,
            }),
            spindle: SpindleModel {
                chain: [
                    Some(ElongationSource::Sensor),
                    Some(ElongationSource::Temperature),
                    Some(ElongationSource::Warmup),
                ],
                sensor: SensorLaw {
                    k0: Nanometres(-1_250),
                    zero: Reading(645_120),
                    slope: Slope(31_998_000),
                },
                temperature: Some(SpindleTemperature {
                    channel: 5,
                    smoothing: SmoothingFactor(u32::MAX),
                    smoothing_falling: SmoothingFactor(9),
                    law: Law { pieces: &pieces },
                }),
                warmup: Some(SpindleWarmup { law, power: curve }),
            },
            kinematics: Kinematics {
                zero: Direction::DOWN,
                axes: [Some(kinematics::RotaryAxis::C), Some(kinematics::RotaryAxis::A)],
            },
            axes: [
                axis,
                AxisModel::default(),
                AxisModel { backlash: Fine(4), ..AxisModel::default() },
            ],
            straightness: [
                curve,
                Curve::default(),
                curve,
                Curve::default(),
                Curve::default(),
                curve,
            ],
            squareness: [-3, -2, -1, 0, 1, 2].map(Gradient),
            terms,
            limits: Limits {
                max: [200_000, 200_000, 500_000].map(Nanometres),
                slew_nm_per_s: 20_000,
                link_timeout_ms: 500,
                hold_ms: 2_000,
            },
        })
    }

    fn sample() -> Vec<u8> {
        with_sample(|calibration| {
            let mut bytes = [0; MAX_SIZE];
            encode(&calibration, &mut bytes).expect("it is small").to_vec()
        })
    }

    /// The blob with its CRC made right again.
    fn mended(mut blob: Vec<u8>) -> Vec<u8> {
        let end = blob.len() - CRC_SIZE;
        let crc = crc::checksum(&blob[..end]).to_le_bytes();
        blob[end..].copy_from_slice(&crc);
        blob
    }

    #[test]
    fn a_calibration_comes_back_whole_with_its_tables_in_place() {
        let blob = sample();
        with_sample(|calibration| assert_eq!(decode(&blob), Ok(calibration)));
        let decoded = decode(&blob).unwrap();
        let table = decoded.axes[0].pitch.unwrap().forward.as_ptr().cast::<u8>();
        assert!(blob.as_ptr_range().contains(&table), "read where it lies");
    }

    #[test]
    fn the_fields_lie_where_the_table_says() {
        let blob = sample();
        let word = |at: usize| i32::from_le_bytes(*blob[at..].first_chunk().unwrap());
        assert_eq!(&blob[..6], b"TRUP\x03\x00");
        assert_eq!(usize::from(u16::from_le_bytes([blob[6], blob[7]])), blob.len());
        for (at, value) in [
            (8, 200_000),
            (20, 20_000),
            (28, 2_000),
            (40, -Direction::ONE),
            (44, 0x0103),
            (48, 0x0003_0201),
            (56, 645_120),
            (64, 5),
            (76, 60_000),
            (112 + 24, 1),
            (112 + 60, 0x0702),
            (208, 2),
            (216, -9),
            (208 + 60, -77),
            (288, 255),
            (368 + 60, 4),
            (544, -3),
            (568, 9),
        ] {
            assert_eq!(word(at), value, "at {at}");
        }
        let tables = usize::from(u16::from_le_bytes([blob[72], blob[73]]));
        assert_eq!(tables, FIXED_SIZE, "the first table follows the fixed part");
        let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
        assert_eq!([blob[574], blob[575]], [13, 0]);
        // The fifth: heat of channel 7 on Y.
        assert_eq!(blob[terms + 4 * 24..][..4], [4, 2, 7, 11]);
        assert_eq!(word(terms + 4 * 24 + 12), 21);
    }

    #[test]
    fn every_single_bit_flip_is_refused() {
        let good = sample();
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            let error = decode(&bad).expect_err("a flipped bit");
            let right_kind = match bit / 8 {
                0..4 => matches!(error, BlobError::Magic { .. }),
                4..6 => matches!(error, BlobError::Schema { .. }),
                6..8 => !matches!(error, BlobError::Magic { .. } | BlobError::Schema { .. }),
                _ => matches!(error, BlobError::Crc { .. }),
            };
            assert!(right_kind, "bit {bit}: {error}");
        }
    }

    #[test]
    fn every_cut_is_refused_and_what_follows_is_not_looked_at() {
        let good = sample();
        let slot = [&good[..], &[0xFF; 100]].concat();
        for len in 0..good.len() {
            assert_eq!(decode(&slot[..len]), Err(BlobError::TooShort { len }));
        }
        assert_eq!(decode(&slot), decode(&good));
    }

    #[test]
    fn erased_flash_is_no_calibration() {
        let found = [0xFF; 4];
        assert_eq!(decode(&[0xFF; 1_000]), Err(BlobError::Magic { found }));
    }

    #[test]
    fn values_without_a_meaning_are_refused_with_their_place() {
        for (at, bytes, error) in [
            (8, [0xFF; 4], BlobError::MaxOffset { offset: 8, found: -1 }),
            (
                16,
                5_242_871_i32.to_le_bytes(),
                BlobError::MaxOffset { offset: 16, found: 5_242_871 },
            ),
            (40, [0; 4], BlobError::NotUnit { offset: 32, found: [0; 3] }),
            (44, [4, 0, 0, 0], BlobError::Value { offset: 44, found: 4 }),
            (48, [0, 9, 0, 0], BlobError::Value { offset: 48, found: 9 }),
            (64, [8, 0, 0, 0], BlobError::Value { offset: 64, found: 8 }),
            (112, [3, 0, 0, 0], BlobError::Value { offset: 112, found: 3 }),
            (72, [0xFF, 0xFF, 1, 0], BlobError::Table { offset: 72 }),
            (72, [0, 0, 1, 0], BlobError::Table { offset: 72 }),
            (228, [0; 4], BlobError::Table { offset: 224 }),
            (240, [3, 0, 0, 0], BlobError::Value { offset: 240, found: 3 }),
        ] {
            let mut blob = sample();
            blob[at..at + 4].copy_from_slice(&bytes);
            assert_eq!(decode(&mended(blob)), Err(error), "at {at}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_size() {
        with_sample(|calibration| {
            let mut small = [0; 700];
            let error = encode(&calibration, &mut small).expect_err("it is larger");
            assert_eq!(error.bytes, sample().len());
        });
    }

    proptest! {
        #[test]
        fn no_bytes_panic(
            at in 8_usize..FIXED_SIZE, bytes in prop::collection::vec(any::<u8>(), 1..40),
            cut in 0_usize..1_000,
        ) {
            let mut blob = sample();
            let end = (at + bytes.len()).min(blob.len() - CRC_SIZE);
            blob[at..end].copy_from_slice(&bytes[..end - at]);
            let blob = mended(blob);
            let _ = decode(&blob);
            let _ = decode(&blob[..cut.min(blob.len())]);
        }
    }
}
