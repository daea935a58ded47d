//! The terms of a diagnosis: a table of records, whose own tables follow it.

use trueup_core::{
    cnc::LinearAxis,
    curve::Curve,
    design_parameters::{CONDITION_COUNT, MAX_TERMS, MAX_TOOLS, TEMPERATURE_CHANNEL_COUNT},
    fixed_point::ScaledCoefficient,
    gradient::Gradient,
    lag::SmoothingFactor,
    pitch_table::PitchErrorTable,
    reversal::Interval,
    term::{
        self, CategoryFactor, ConditionLevels, Effect, SpeedExponent, Target, Term, Tilt, ToolTable,
    },
    units::{FineNanometres, Position, Temperature},
    volumetric_error::VolumetricErrorModel,
};

use super::{
    blob_codec::{Field, Reader, Writer},
    blob_fields::decode_linear_axis,
    error::BlobError,
    volume,
};

/// Bytes of a term.
const TERM_SIZE: usize = 24;
/// Bytes of its head and its constant.
const HEADER_SIZE: usize = 8;
/// The most binary places of a coefficient.
const MAX_COEFFICIENT_SHIFT: u8 = 62;
/// The bytes of a term's head, next to its kind, which is the first.
const TARGET_OFFSET: usize = 1;
const INPUT_OFFSET: usize = 2;
const SHIFT_OFFSET: usize = 3;

/// The terms, and after them the errors of the volume, which a calibration may have next to them.
pub(super) struct TermsAndVolumetricErrors<'b>(
    pub term::Terms<'b>,
    pub Option<VolumetricErrorModel<'b>>,
);

impl<'b> Field<'b> for TermsAndVolumetricErrors<'b> {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        let Self(terms, volume) = self;
        // Room first: the tables of the terms come behind all of them.
        let room = [[0_u8; TERM_SIZE]; MAX_TERMS + 1];
        let count = terms.iter().flatten().count().saturating_add(volume.iter().count());
        let mut place = to.write_table(room.get(..count).unwrap_or_default());
        for term in terms.iter().flatten() {
            to.term = place;
            to.write_at(place, |to| term.write(to));
            place = place.saturating_add(TERM_SIZE);
        }
        if let Some(it) = volume {
            to.write_at(place, |to| {
                to.write_bytes(&[volume::VOLUMETRIC_TERM_KIND, 0, 0, 0]);
                FineNanometres::ZERO.write(to);
                volume::write_volumetric_errors(it, to);
            });
        }
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let records = from.read_records::<TERM_SIZE>();
        let start = from.read_at(offset, u32::read) & 0xFFFF;
        let mut place = usize::try_from(start).unwrap_or(usize::MAX);
        let mut all = Self([None; MAX_TERMS], None);
        // The volume is the last.
        let (terms, last) = match records.split_last() {
            Some(([volume::VOLUMETRIC_TERM_KIND, ..], terms)) => (terms, true),
            _ => (records, false),
        };
        if terms.len() > MAX_TERMS {
            from.reject(BlobError::Table { offset });
        }
        for (term, _) in all.0.iter_mut().zip(terms) {
            from.term = place;
            *term = Some(from.read_at(place, Term::read));
            place = place.saturating_add(TERM_SIZE);
        }
        if last {
            all.1 = from.read_at(place.saturating_add(HEADER_SIZE), volume::read_volumetric_errors);
        }
        all
    }
}

/// Head, constant, and what the effect has.
impl<'b> Field<'b> for Term<'b> {
    const SIZE: usize = TERM_SIZE;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_bytes(&[0; 4]);
        to.write_term_byte(
            TARGET_OFFSET,
            match self.target {
                Target::Elongation => 0,
                Target::Axis(LinearAxis::X) => 1,
                Target::Axis(LinearAxis::Y) => 2,
                Target::Axis(LinearAxis::Z) => 3,
            },
        );
        self.constant.write(to);
        write_effect(&self.effect, to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [kind, target, _, shift] = from.read_bytes();
        let target = match target {
            0 => Some(Target::Elongation),
            1 => Some(Target::Axis(LinearAxis::X)),
            2 => Some(Target::Axis(LinearAxis::Y)),
            3 => Some(Target::Axis(LinearAxis::Z)),
            found => from.reject_value(offset, found),
        };
        if shift > MAX_COEFFICIENT_SHIFT {
            from.reject(BlobError::Value { offset, found: shift.into() });
        }
        Self {
            target: target.unwrap_or(Target::Elongation),
            constant: FineNanometres::read(from),
            effect: read_effect(kind, from),
        }
    }
}

/// Declares the kinds of terms: number, effect, and what follows the constant, in its order.
macro_rules! effects {
    ($($kind:literal $effect:ident { $($field:tt $name:ident: $type:ty),* })*) => {
        fn write_effect(effect: &Effect<'_>, to: &mut Writer<'_>) {
            match effect {$(
                Effect::$effect { $($field: $name),* } => {
                    to.write_term_byte(0, $kind);
                    $($name.write(to);)*
                }
            )*}
        }

        fn read_effect<'b>(kind: u8, from: &mut Reader<'b>) -> Effect<'b> {
            match kind {
                $($kind => {
                    $(let $name = <$type>::read(from);)*
                    Effect::$effect { $($field: $name),* }
                })*
                found => from.reject_value(from.term, found).unwrap_or(Effect::Offset),
            }
        }
    };
}

effects! {
    0 Offset {}
    1 Gain { 0 coefficient: ScaledCoefficient }
    2 Curvature { 0 coefficient: ScaledCoefficient }
    3 Saturation { 0 limit: FineNanometres }
    4 Heat {
        per_temperature coefficient: ScaledCoefficient,
        smoothing smoothing: SmoothingFactor,
        reference reference: Temperature,
        channel channel: u8
    }
    5 Time { amplitude coefficient: ScaledCoefficient, smoothing smoothing: SmoothingFactor }
    6 Speed { 0 coefficient: ScaledCoefficient }
    7 Load { 0 coefficient: ScaledCoefficient }
    8 Position { axis axis: LinearAxis, gradient gradient: Gradient }
    9 Reversed { width width: FineNanometres, gradient gradient: Gradient }
    10 Table { 0 pitch: PitchErrorTable<'b> }
    11 Curve { axis axis: LinearAxis, curve curve: Curve<'b> }
    12 Wave { amplitude amplitude: FineNanometres, phase phase: u32, turns turns: u64 }
    13 TiltLine { 0 tilt: Tilt<Gradient> }
    14 TiltCurve { 0 tilt: Tilt<Curve<'b>> }
    15 SpeedHeat {
        per_unit coefficient: ScaledCoefficient,
        smoothing smoothing: SmoothingFactor,
        power power: SpeedExponent
    }
    16 Tool { 0 tools: ToolTable<'b> }
    17 Condition { 0 condition: ConditionLevels }
    19 HeatSlope {
        per_temperature coefficient: ScaledCoefficient,
        smoothing smoothing: SmoothingFactor,
        reference reference: Temperature,
        channel channel: u8
    }
}

/// A coefficient of a term: its binary places stand in the head.
impl<'b> Field<'b> for ScaledCoefficient {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_term_byte(SHIFT_OFFSET, self.shift);
        self.mantissa.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self { mantissa: i32::read(from), shift: from.read_term_byte(SHIFT_OFFSET) }
    }
}

/// The axis of a term stands in the head.
impl<'b> Field<'b> for LinearAxis {
    const SIZE: usize = 0;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_term_byte(INPUT_OFFSET, *self as u8);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let number = from.read_term_byte(INPUT_OFFSET);
        let axis =
            decode_linear_axis(number.into()).or_else(|| from.reject_value(from.term, number));
        axis.unwrap_or(Self::X)
    }
}

/// The channel of a term stands in the head.
impl<'b> Field<'b> for u8 {
    const SIZE: usize = 0;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_term_byte(INPUT_OFFSET, *self);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let channel = from.read_term_byte(INPUT_OFFSET);
        if usize::from(channel) >= TEMPERATURE_CHANNEL_COUNT {
            from.reject(BlobError::Value { offset: from.term, found: channel.into() });
        }
        channel
    }
}

/// The power of the speed stands in the head: 1 or 2.
impl<'b> Field<'b> for SpeedExponent {
    const SIZE: usize = 0;

    fn write(&self, to: &mut Writer<'_>) {
        let exponent = match self {
            Self::First => 1,
            Self::Second => 2,
        };
        to.write_term_byte(INPUT_OFFSET, exponent);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        match from.read_term_byte(INPUT_OFFSET) {
            1 => Self::First,
            2 => Self::Second,
            found => from.reject_value(from.term, found).unwrap_or(Self::First),
        }
    }
}

/// Zero of the lever, gradient; both axes stand in the head, that of the lever in the high half.
impl<'b> Field<'b> for Tilt<Gradient> {
    const SIZE: usize = 8;

    fn write(&self, to: &mut Writer<'_>) {
        write_tilt_axes(self, to);
        self.angle.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        read_tilt(from, Gradient::read)
    }
}

/// Likewise with a curve, whose bucket shift stands in the head: its word is the lever's.
impl<'b> Field<'b> for Tilt<Curve<'b>> {
    const SIZE: usize = 16;

    fn write(&self, to: &mut Writer<'_>) {
        write_tilt_axes(self, to);
        to.write_term_byte(SHIFT_OFFSET, self.angle.bucket_shift());
        to.write_table(self.angle.segments());
        to.write_table(self.angle.index());
        self.angle.first_knot().write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        read_tilt(from, |from| {
            let offset = from.at;
            let (segments, index) = (from.read_records(), from.read_records());
            let curve = Curve::new(
                Position::read(from),
                segments,
                index,
                from.read_term_byte(SHIFT_OFFSET),
            );
            if !curve.is_consistent() {
                from.reject(BlobError::Table { offset });
            }
            curve
        })
    }
}

/// The level of other tools, the table, and what they are multiplied by; the binary places stand in the head.
impl<'b> Field<'b> for ToolTable<'b> {
    const SIZE: usize = 12;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_term_byte(SHIFT_OFFSET, self.shift);
        self.other.write(to);
        to.write_table(self.levels);
        u32::from(self.times as u8).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let (other, offset) = (i32::read(from), from.at);
        let levels = from.read_records();
        let [times, is_default] = read_factor_and_default(from);
        let read = Self {
            levels,
            other,
            shift: from.read_term_byte(SHIFT_OFFSET),
            times: CategoryFactor::from_number(times).unwrap_or_default(),
        };
        let is_tool = |(number, _)| number <= u32::from(u16::MAX);
        let is_rising = read.tool_levels().is_sorted_by(|(a, _), (b, _)| a < b);
        if levels.len() > MAX_TOOLS
            || !is_rising
            || !read.tool_levels().all(is_tool)
            || is_default != 0
        {
            from.reject(BlobError::Table { offset });
        }
        read
    }
}

/// Both levels, the lag, and in a word the factor and the default; bit and binary places stand in the head.
impl<'b> Field<'b> for ConditionLevels {
    const SIZE: usize = 16;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_term_byte(INPUT_OFFSET, self.bit);
        to.write_term_byte(SHIFT_OFFSET, self.shift);
        self.off.write(to);
        self.on.write(to);
        self.smoothing.write(to);
        u32::from_le_bytes([self.times as u8, self.default.into(), 0, 0]).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let bit = from.read_term_byte(INPUT_OFFSET);
        if bit >= CONDITION_COUNT {
            from.reject(BlobError::Value { offset: from.term, found: bit.into() });
        }
        let (off, on, smoothing) = (i32::read(from), i32::read(from), SmoothingFactor::read(from));
        let [times, default] = read_factor_and_default(from);
        Self {
            bit,
            default: default != 0,
            off,
            on,
            shift: from.read_term_byte(SHIFT_OFFSET),
            smoothing,
            times: CategoryFactor::from_number(times).unwrap_or_default(),
        }
    }
}

/// Reads the numbers of a factor and of a default, 0 or 1.
fn read_factor_and_default(from: &mut Reader<'_>) -> [u8; 2] {
    let offset = from.at;
    let word = u32::read(from);
    let [times, default, rest @ ..] = word.to_le_bytes();
    if CategoryFactor::from_number(times).is_none() || default > 1 || rest != [0; 2] {
        from.reject(BlobError::Value { offset, found: word });
    }
    [times, default]
}

fn write_tilt_axes<A>(tilt: &Tilt<A>, to: &mut Writer<'_>) {
    to.write_term_byte(INPUT_OFFSET, tilt.along as u8 | (tilt.lever as u8) << 4);
    tilt.origin.write(to);
}

/// Reads the axes and the zero of the lever, then the angle.
fn read_tilt<'b, A>(from: &mut Reader<'b>, angle: impl FnOnce(&mut Reader<'b>) -> A) -> Tilt<A> {
    let axes = from.read_term_byte(INPUT_OFFSET);
    let mut axis = |number: u8| {
        let axis = decode_linear_axis(number.into()).or_else(|| from.reject_value(from.term, axes));
        axis.unwrap_or(LinearAxis::X)
    };
    let (along, lever) = (axis(axes & 0xF), axis(axes >> 4));
    Tilt { along, lever, origin: Position::read(from), angle: angle(from) }
}

/// A term over a table has one.
impl<'b> Field<'b> for PitchErrorTable<'b> {
    const SIZE: usize = Option::<Self>::SIZE;

    fn write(&self, to: &mut Writer<'_>) {
        Some(*self).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Option::<Self>::read(from).unwrap_or_else(|| {
            from.reject(BlobError::Table { offset: from.term });
            Self { start: Position(0), step: Interval::new(0), forward: &[], reverse: None }
        })
    }
}
