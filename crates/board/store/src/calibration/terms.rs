//! The terms of a diagnosis: a table of records, whose own tables follow it.

use trueup_core::{
    cnc::LinearAxis,
    curve::Curve,
    dimensions::{CHANNELS, CONDITIONS, MAX_TERMS, MAX_TOOLS},
    fixed::Scaled,
    gradient::Gradient,
    lag::SmoothingFactor,
    pitch::Pitch,
    term::{self, Effect, Factor, OnOff, SpeedPower, Target, Term, Tilt, ToolTable},
    travel::Interval,
    units::{Fine, Position, Temperature},
    volume::Volume,
};

use super::{
    error::BlobError,
    quantities::linear_axis,
    volume,
    wire::{Field, Reader, Writer},
};

/// Bytes of a term.
const TERM_SIZE: usize = 24;
/// Bytes of its head and its constant.
const HEAD_SIZE: usize = 8;
/// The most binary places of a coefficient.
const MAX_SHIFT: u8 = 62;
/// The bytes of a term's head, next to its kind, which is the first.
const TARGET: usize = 1;
const INPUT: usize = 2;
const SHIFT: usize = 3;

/// The terms, and after them the errors of the volume, which a calibration may have next to them.
pub(super) struct Terms<'b>(pub term::Terms<'b>, pub Option<Volume<'b>>);

impl<'b> Field<'b> for Terms<'b> {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        let Self(terms, volume) = self;
        // Room first: the tables of the terms come behind all of them.
        let room = [[0_u8; TERM_SIZE]; MAX_TERMS + 1];
        let count = terms.iter().flatten().count().saturating_add(volume.iter().count());
        let mut place = to.table(room.get(..count).unwrap_or_default());
        for term in terms.iter().flatten() {
            to.term = place;
            to.elsewhere(place, |to| term.put(to));
            place = place.saturating_add(TERM_SIZE);
        }
        if let Some(it) = volume {
            to.elsewhere(place, |to| {
                to.bytes(&[volume::KIND, 0, 0, 0]);
                Fine::ZERO.put(to);
                volume::put(it, to);
            });
        }
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let records = from.table::<TERM_SIZE>();
        let start = from.elsewhere(offset, u32::get) & 0xFFFF;
        let mut place = usize::try_from(start).unwrap_or(usize::MAX);
        let mut all = Self([None; MAX_TERMS], None);
        // The volume is the last.
        let (terms, last) = match records.split_last() {
            Some(([volume::KIND, ..], terms)) => (terms, true),
            _ => (records, false),
        };
        if terms.len() > MAX_TERMS {
            from.refuse(BlobError::Table { offset });
        }
        for (term, _) in all.0.iter_mut().zip(terms) {
            from.term = place;
            *term = Some(from.elsewhere(place, Term::get));
            place = place.saturating_add(TERM_SIZE);
        }
        if last {
            all.1 = from.elsewhere(place.saturating_add(HEAD_SIZE), volume::get);
        }
        all
    }
}

/// Head, constant, and what the effect has.
impl<'b> Field<'b> for Term<'b> {
    const SIZE: usize = TERM_SIZE;

    fn put(&self, to: &mut Writer<'_>) {
        to.bytes(&[0; 4]);
        to.term_byte(
            TARGET,
            match self.target {
                Target::Elongation => 0,
                Target::Axis(LinearAxis::X) => 1,
                Target::Axis(LinearAxis::Y) => 2,
                Target::Axis(LinearAxis::Z) => 3,
            },
        );
        self.constant.put(to);
        put_effect(&self.effect, to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [kind, target, _, shift] = from.bytes();
        let target = match target {
            0 => Some(Target::Elongation),
            1 => Some(Target::Axis(LinearAxis::X)),
            2 => Some(Target::Axis(LinearAxis::Y)),
            3 => Some(Target::Axis(LinearAxis::Z)),
            found => from.refuse_value(offset, found),
        };
        if shift > MAX_SHIFT {
            from.refuse(BlobError::Value { offset, found: shift.into() });
        }
        Self {
            target: target.unwrap_or(Target::Elongation),
            constant: Fine::get(from),
            effect: get_effect(kind, from),
        }
    }
}

/// Declares the kinds of terms: number, effect, and what follows the constant, in its order.
macro_rules! effects {
    ($($kind:literal $effect:ident { $($field:tt $name:ident: $type:ty),* })*) => {
        fn put_effect(effect: &Effect<'_>, to: &mut Writer<'_>) {
            match effect {$(
                Effect::$effect { $($field: $name),* } => {
                    to.term_byte(0, $kind);
                    $($name.put(to);)*
                }
            )*}
        }

        fn get_effect<'b>(kind: u8, from: &mut Reader<'b>) -> Effect<'b> {
            match kind {
                $($kind => {
                    $(let $name = <$type>::get(from);)*
                    Effect::$effect { $($field: $name),* }
                })*
                found => from.refuse_value(from.term, found).unwrap_or(Effect::Offset),
            }
        }
    };
}

effects! {
    0 Offset {}
    1 Gain { 0 coefficient: Scaled }
    2 Curvature { 0 coefficient: Scaled }
    3 Saturation { 0 limit: Fine }
    4 Heat {
        per_temperature coefficient: Scaled,
        smoothing smoothing: SmoothingFactor,
        reference reference: Temperature,
        channel channel: u8
    }
    5 Time { amplitude coefficient: Scaled, smoothing smoothing: SmoothingFactor }
    6 Speed { 0 coefficient: Scaled }
    7 Load { 0 coefficient: Scaled }
    8 Position { axis axis: LinearAxis, gradient gradient: Gradient }
    9 Reversed { width width: Fine, gradient gradient: Gradient }
    10 Table { 0 pitch: Pitch<'b> }
    11 Curve { axis axis: LinearAxis, curve curve: Curve<'b> }
    12 Wave { amplitude amplitude: Fine, phase phase: u32, turns turns: u64 }
    13 TiltLine { 0 tilt: Tilt<Gradient> }
    14 TiltCurve { 0 tilt: Tilt<Curve<'b>> }
    15 SpeedHeat {
        per_unit coefficient: Scaled,
        smoothing smoothing: SmoothingFactor,
        power power: SpeedPower
    }
    16 Tool { 0 tools: ToolTable<'b> }
    17 Condition { 0 condition: OnOff }
    19 HeatSlope {
        per_temperature coefficient: Scaled,
        smoothing smoothing: SmoothingFactor,
        reference reference: Temperature,
        channel channel: u8
    }
}

/// A coefficient of a term: its binary places stand in the head.
impl<'b> Field<'b> for Scaled {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        to.term_byte(SHIFT, self.shift);
        self.mantissa.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        Self { mantissa: i32::get(from), shift: from.term_byte(SHIFT) }
    }
}

/// The axis of a term stands in the head.
impl<'b> Field<'b> for LinearAxis {
    const SIZE: usize = 0;

    fn put(&self, to: &mut Writer<'_>) {
        to.term_byte(INPUT, *self as u8);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let number = from.term_byte(INPUT);
        let axis = linear_axis(number.into()).or_else(|| from.refuse_value(from.term, number));
        axis.unwrap_or(Self::X)
    }
}

/// The channel of a term stands in the head.
impl<'b> Field<'b> for u8 {
    const SIZE: usize = 0;

    fn put(&self, to: &mut Writer<'_>) {
        to.term_byte(INPUT, *self);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let channel = from.term_byte(INPUT);
        if usize::from(channel) >= CHANNELS {
            from.refuse(BlobError::Value { offset: from.term, found: channel.into() });
        }
        channel
    }
}

/// The power of the speed stands in the head: 1 or 2.
impl<'b> Field<'b> for SpeedPower {
    const SIZE: usize = 0;

    fn put(&self, to: &mut Writer<'_>) {
        let exponent = match self {
            Self::First => 1,
            Self::Second => 2,
        };
        to.term_byte(INPUT, exponent);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        match from.term_byte(INPUT) {
            1 => Self::First,
            2 => Self::Second,
            found => from.refuse_value(from.term, found).unwrap_or(Self::First),
        }
    }
}

/// Zero of the lever, gradient; both axes stand in the head, that of the lever in the high half.
impl<'b> Field<'b> for Tilt<Gradient> {
    const SIZE: usize = 8;

    fn put(&self, to: &mut Writer<'_>) {
        put_axes(self, to);
        self.angle.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        get_axes(from, Gradient::get)
    }
}

/// Likewise with a curve, whose bucket shift stands in the head: its word is the lever's.
impl<'b> Field<'b> for Tilt<Curve<'b>> {
    const SIZE: usize = 16;

    fn put(&self, to: &mut Writer<'_>) {
        put_axes(self, to);
        to.term_byte(SHIFT, self.angle.bucket_shift());
        to.table(self.angle.segments());
        to.table(self.angle.index());
        self.angle.first().put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        get_axes(from, |from| {
            let offset = from.at;
            let (segments, index) = (from.table(), from.table());
            let curve = Curve::new(Position::get(from), segments, index, from.term_byte(SHIFT));
            if !curve.is_consistent() {
                from.refuse(BlobError::Table { offset });
            }
            curve
        })
    }
}

/// The level of other tools, the table, and what they are multiplied by; the binary places stand in the head.
impl<'b> Field<'b> for ToolTable<'b> {
    const SIZE: usize = 12;

    fn put(&self, to: &mut Writer<'_>) {
        to.term_byte(SHIFT, self.shift);
        self.other.put(to);
        to.table(self.levels);
        u32::from(self.times as u8).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let (other, offset) = (i32::get(from), from.at);
        let levels = from.table();
        let [times, is_default] = factor(from);
        let read = Self {
            levels,
            other,
            shift: from.term_byte(SHIFT),
            times: Factor::from_number(times).unwrap_or_default(),
        };
        let is_tool = |(number, _)| number <= u32::from(u16::MAX);
        let is_rising = read.tools().is_sorted_by(|(a, _), (b, _)| a < b);
        if levels.len() > MAX_TOOLS || !is_rising || !read.tools().all(is_tool) || is_default != 0 {
            from.refuse(BlobError::Table { offset });
        }
        read
    }
}

/// Both levels, the lag, and in a word the factor and the default; bit and binary places stand in the head.
impl<'b> Field<'b> for OnOff {
    const SIZE: usize = 16;

    fn put(&self, to: &mut Writer<'_>) {
        to.term_byte(INPUT, self.bit);
        to.term_byte(SHIFT, self.shift);
        self.off.put(to);
        self.on.put(to);
        self.smoothing.put(to);
        u32::from_le_bytes([self.times as u8, self.default.into(), 0, 0]).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let bit = from.term_byte(INPUT);
        if bit >= CONDITIONS {
            from.refuse(BlobError::Value { offset: from.term, found: bit.into() });
        }
        let (off, on, smoothing) = (i32::get(from), i32::get(from), SmoothingFactor::get(from));
        let [times, default] = factor(from);
        Self {
            bit,
            default: default != 0,
            off,
            on,
            shift: from.term_byte(SHIFT),
            smoothing,
            times: Factor::from_number(times).unwrap_or_default(),
        }
    }
}

/// Reads the numbers of a factor and of a default, 0 or 1.
fn factor(from: &mut Reader<'_>) -> [u8; 2] {
    let offset = from.at;
    let word = u32::get(from);
    let [times, default, rest @ ..] = word.to_le_bytes();
    if Factor::from_number(times).is_none() || default > 1 || rest != [0; 2] {
        from.refuse(BlobError::Value { offset, found: word });
    }
    [times, default]
}

fn put_axes<A>(tilt: &Tilt<A>, to: &mut Writer<'_>) {
    to.term_byte(INPUT, tilt.along as u8 | (tilt.lever as u8) << 4);
    tilt.origin.put(to);
}

/// Reads the axes and the zero of the lever, then the angle.
fn get_axes<'b, A>(from: &mut Reader<'b>, angle: impl FnOnce(&mut Reader<'b>) -> A) -> Tilt<A> {
    let axes = from.term_byte(INPUT);
    let mut axis = |number: u8| {
        let axis = linear_axis(number.into()).or_else(|| from.refuse_value(from.term, axes));
        axis.unwrap_or(LinearAxis::X)
    };
    let (along, lever) = (axis(axes & 0xF), axis(axes >> 4));
    Tilt { along, lever, origin: Position::get(from), angle: angle(from) }
}

/// A term over a table has one.
impl<'b> Field<'b> for Pitch<'b> {
    const SIZE: usize = Option::<Self>::SIZE;

    fn put(&self, to: &mut Writer<'_>) {
        Some(*self).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        Option::<Self>::get(from).unwrap_or_else(|| {
            from.refuse(BlobError::Table { offset: from.term });
            Self { start: Position(0), step: Interval::new(0), forward: &[], reverse: None }
        })
    }
}
