//! The fields that are quantities, numbers of things, and tables of core.

use trueup_core::{
    calibration::{ElongationSource, Mains},
    cnc::LinearAxis,
    curve::Curve,
    dimensions::CHANNELS,
    gradient::Gradient,
    kinematics::RotaryAxis,
    lag::SmoothingFactor,
    pitch::Pitch,
    sensor::{SensorLaw, Slope},
    thermal::Law,
    thermal_rate::MAX_TENTHS,
    thermometer::Thermometer,
    tool::Direction,
    travel::Interval,
    units::{Fine, Nanometres, Position, Reading, Temperature},
    warmup::Warmup,
};

use super::{
    error::BlobError,
    format::{MAX_COLD_WITHIN, MAX_LEARNED, MAX_OFFSET_NM, MAX_REJOIN_NM_PER_S, NONE},
    wire::{Field, Reader, Writer, fields, numbers},
};

/// How far the square of the tool direction's length may be from 1, in 2⁻⁶⁰: 2⁻¹⁹. The length is
/// then right to 10⁻⁶, 1 nm of a millimetre; rounding to 2⁻³⁰ alone makes 2·10⁻⁹.
const UNIT_TOLERANCE: u64 = 1 << 41;

numbers! {
    Nanometres: i32,
    Fine: i32,
    Position: i32,
    Temperature: i32,
    Reading: i32,
    Slope: i32,
    Gradient: i32,
    SmoothingFactor: u32,
}

fields!(SensorLaw { k0: Nanometres, zero: Reading, slope: Slope });

fields!(Warmup {
    lag_ms: u32,
    max: Fine,
    smoothing_heating: SmoothingFactor,
    smoothing_cooling: SmoothingFactor,
    full: i32,
});

/// The largest offset on an axis, 0 nm…[`MAX_OFFSET_NM`].
pub(super) struct MaxOffset(pub Nanometres);

impl<'b> Field<'b> for MaxOffset {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        self.0.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let max = Nanometres::get(from);
        if !(0..=MAX_OFFSET_NM).contains(&max.0) {
            from.refuse(BlobError::MaxOffset { offset, found: max.0 });
        }
        Self(max)
    }
}

/// A number of a limit, at most `MAX`.
pub(super) struct Limit<const MAX: u32>(pub u32);

impl<'b, const MAX: u32> Field<'b> for Limit<MAX> {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        self.0.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let found = u32::get(from);
        if found > MAX {
            from.refuse(BlobError::Limit { offset, found, most: MAX });
        }
        Self(found)
    }
}

/// Within how much the thermometers of a cold machine agree, 0 K…[`MAX_COLD_WITHIN`].
pub(super) struct ColdWithin(pub Temperature);

impl<'b> Field<'b> for ColdWithin {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        self.0.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let within = Temperature::get(from);
        if !(Temperature(0)..=MAX_COLD_WITHIN).contains(&within) {
            let most = MAX_COLD_WITHIN.0.cast_unsigned();
            from.refuse(BlobError::Limit { offset, found: within.0.cast_unsigned(), most });
        }
        Self(within)
    }
}

/// The way back from one source to another, up to [`MAX_REJOIN_NM_PER_S`], and switches in the upper half: bit 0 is the
/// service switch, bit 1 says that the mains have 60 Hz. They are 0 in a blob from before they were known, and a firmware from then refuses one that sets them.
pub(super) struct RejoinAndSwitches(pub u32, pub bool, pub Mains);

impl<'b> Field<'b> for RejoinAndSwitches {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        let switch = if self.1 { SERVICE_SWITCH } else { 0 };
        let mains = if self.2 == Mains::Hz60 { MAINS_60_HZ } else { 0 };
        (self.0 | switch | mains).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let found = u32::get(from);
        let rejoin = found & !(SERVICE_SWITCH | MAINS_60_HZ);
        if rejoin > MAX_REJOIN_NM_PER_S {
            from.refuse(BlobError::Limit { offset, found: rejoin, most: MAX_REJOIN_NM_PER_S });
        }
        let mains = if found & MAINS_60_HZ == 0 { Mains::Hz50 } else { Mains::Hz60 };
        Self(rejoin, found & SERVICE_SWITCH != 0, mains)
    }
}

/// The bit of the service switch.
const SERVICE_SWITCH: u32 = 1 << 16;
/// The bit of mains of 60 Hz.
const MAINS_60_HZ: u32 = 1 << 17;

/// Bytes of a text: a reference to them.
pub(super) struct Text<'b>(pub &'b [u8]);

impl<'b> Field<'b> for Text<'b> {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        to.table(self.0.as_chunks::<1>().0);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        Self(from.table::<1>().as_flattened())
    }
}

impl<'b> Field<'b> for Direction {
    const SIZE: usize = 12;

    fn put(&self, to: &mut Writer<'_>) {
        self.0.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        const ONE_SQUARED: u64 = 1 << (2 * Direction::FRACTION_BITS);
        let offset = from.at;
        let components: [i32; 3] = Field::get(from);
        let squares = components.map(|it| u64::from(it.unsigned_abs()).saturating_pow(2));
        let length_squared = squares.into_iter().fold(0, u64::saturating_add);
        if length_squared.abs_diff(ONE_SQUARED) > UNIT_TOLERANCE {
            from.refuse(BlobError::NotUnit { offset, found: components });
        }
        Self(components)
    }
}

/// The first and the second axis that turn the tool, and the caps of what was learned of the growth and of
/// the axes: four bytes. The caps are 0 in a blob from before they were known: nothing may be changed.
pub(super) struct HeadAxes(pub [Option<RotaryAxis>; 2], pub [u8; 2]);

impl<'b> Field<'b> for HeadAxes {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        let [first, second] = self.0.map(rotary_number);
        let [growth, axes] = self.1;
        to.bytes(&[first, second, growth, axes]);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [first, second, growth, axes] = from.bytes();
        let caps = [from.cap(growth, MAX_LEARNED.growth), from.cap(axes, MAX_LEARNED.axes)];
        let turning = [first, second].map(|number| rotary_axis(number, offset, from));
        Self(turning, caps)
    }
}

/// Returns the number of a rotary axis; 0 of none.
pub(super) const fn rotary_number(axis: Option<RotaryAxis>) -> u8 {
    match axis {
        None => 0,
        Some(RotaryAxis::A) => 1,
        Some(RotaryAxis::B) => 2,
        Some(RotaryAxis::C) => 3,
    }
}

/// Returns the rotary axis with this number, which stands at `offset`; none of 0.
pub(super) fn rotary_axis(number: u8, offset: usize, from: &mut Reader<'_>) -> Option<RotaryAxis> {
    match number {
        0 => None,
        1 => Some(RotaryAxis::A),
        2 => Some(RotaryAxis::B),
        3 => Some(RotaryAxis::C),
        found => from.refuse_value(offset, found),
    }
}

/// The sources of the elongation in their order, and the cap of what was learned of its zero: four bytes.
pub(super) struct Chain(pub [Option<ElongationSource>; 3], pub u8);

impl<'b> Field<'b> for Chain {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        let [first, second, third] = self.0.map(|source| match source {
            None => 0,
            Some(ElongationSource::Sensor) => 1,
            Some(ElongationSource::Temperature) => 2,
            Some(ElongationSource::Warmup) => 3,
        });
        to.bytes(&[first, second, third, self.1]);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [first, second, third, zero] = from.bytes();
        let zero = from.cap(zero, MAX_LEARNED.zero);
        let sources = [first, second, third].map(|number| match number {
            0 => None,
            1 => Some(ElongationSource::Sensor),
            2 => Some(ElongationSource::Temperature),
            3 => Some(ElongationSource::Warmup),
            found => from.refuse_value(offset, found),
        });
        Self(sources, zero)
    }
}

/// A temperature channel, if there is one.
pub(super) struct Channel(pub Option<u8>);

impl<'b> Field<'b> for Channel {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        self.0.map_or(NONE, u32::from).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        Self(match u32::get(from) {
            NONE => None,
            found => match u8::try_from(found) {
                Ok(channel) if usize::from(channel) < CHANNELS => Some(channel),
                _ => from.refuse_value(offset, found),
            },
        })
    }
}

/// A linear axis, if there is one.
impl<'b> Field<'b> for Option<LinearAxis> {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        self.map_or(NONE, |axis| axis as u32).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        match u32::get(from) {
            NONE => None,
            found => linear_axis(found).or_else(|| from.refuse_value(offset, found)),
        }
    }
}

/// Returns the axis with this number.
pub(super) const fn linear_axis(number: u32) -> Option<LinearAxis> {
    match number {
        0 => Some(LinearAxis::X),
        1 => Some(LinearAxis::Y),
        2 => Some(LinearAxis::Z),
        _ => None,
    }
}

/// The thermometer of a temperature channel, and how fast it may change: kind, shift, two bytes of the rate, zero,
/// slope. The rate is 0 in a blob from before it was known: the default.
pub(super) struct Connected(pub Option<Thermometer>, pub u16);

impl<'b> Field<'b> for Connected {
    const SIZE: usize = 12;

    fn put(&self, to: &mut Writer<'_>) {
        let (kind, shift, zero, slope) = match self.0 {
            None => (0, 0, 0, 0),
            Some(Thermometer::Pt100) => (1, 0, 0, 0),
            Some(Thermometer::Linear { zero, slope, shift }) => (2, shift, zero, slope),
        };
        let [low, high] = self.1.to_le_bytes();
        to.bytes(&[kind, shift, low, high]);
        [zero, slope].put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [kind, shift, low, high] = from.bytes();
        let rate = u16::from_le_bytes([low, high]);
        if rate > MAX_TENTHS {
            from.refuse(BlobError::Limit { offset, found: rate.into(), most: MAX_TENTHS.into() });
        }
        let (zero, slope) = (i32::get(from), i32::get(from));
        let thermometer = match kind {
            0 => None,
            1 => Some(Thermometer::Pt100),
            2 => Some(Thermometer::Linear { zero, slope, shift }),
            found => from.refuse_value(offset, found),
        };
        Self(thermometer, rate)
    }
}

impl<'b> Field<'b> for Interval {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        self.length().put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        Self::new(u32::get(from))
    }
}

impl<'b> Field<'b> for Law<'b> {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        to.table(self.pieces);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        Self { pieces: from.table() }
    }
}

impl<'b> Field<'b> for Curve<'b> {
    const SIZE: usize = 16;

    fn put(&self, to: &mut Writer<'_>) {
        to.table(self.segments());
        to.table(self.index());
        self.first().put(to);
        u32::from(self.bucket_shift()).put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let (segments, index) = (from.table(), from.table());
        let first = Position::get(from);
        let shift = u32::get(from);
        let bucket_shift = u8::try_from(shift).ok().or_else(|| from.refuse_value(offset, shift));
        let curve = Self::new(first, segments, index, bucket_shift.unwrap_or_default());
        if !curve.is_consistent() {
            from.refuse(BlobError::Table { offset });
        }
        curve
    }
}

/// A pitch table, if there is one: without points there is none.
impl<'b> Field<'b> for Option<Pitch<'b>> {
    const SIZE: usize = 16;

    fn put(&self, to: &mut Writer<'_>) {
        let Some(pitch) = self else { return [0_u32; 4].put(to) };
        pitch.start.put(to);
        pitch.step.put(to);
        to.table(pitch.forward);
        to.table(pitch.reverse.unwrap_or_default());
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let (start, step) = (Position::get(from), u32::get(from));
        let (forward, reverse) = (from.table(), from.table());
        if forward.is_empty() {
            return None;
        }
        let reverse = (!reverse.is_empty()).then_some(reverse);
        let pitch = Pitch { start, step: Interval::new(step), forward, reverse };
        if !pitch.is_consistent() {
            from.refuse(BlobError::Table { offset });
        }
        Some(pitch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{MAX_SIZE, decode, encode, tests::with_sample};
    use trueup_core::calibration::Guards;

    #[test]
    fn thermometers_of_a_cold_machine_agree_within_5_kelvin_at_the_most() {
        let most = 5 * Temperature::PER_KELVIN;
        for (within, is_taken) in [(0, true), (most, true), (most + 1, false), (-1, false)] {
            with_sample(|mut calibration| {
                calibration.cold_within = Temperature(within);
                let mut bytes = [0; MAX_SIZE];
                let blob = encode(&calibration, &mut bytes).expect("it is small");
                assert_eq!(decode(blob) == Ok(calibration), is_taken, "{within}");
            });
        }
    }

    #[test]
    fn a_channel_changes_by_up_to_600_kelvin_a_minute_and_not_by_more() {
        for (tenths, is_taken) in
            [(0, true), (1, true), (MAX_TENTHS, true), (MAX_TENTHS + 1, false)]
        {
            with_sample(|mut calibration| {
                calibration.guards.max_rates[3] = tenths;
                let mut bytes = [0; MAX_SIZE];
                let blob = encode(&calibration, &mut bytes).expect("it is small");
                assert_eq!(decode(blob) == Ok(calibration), is_taken, "{tenths}");
            });
        }
    }

    #[test]
    fn each_switch_is_one_bit_that_is_0_in_a_blob_without_it_and_no_other_is_taken() {
        type Set = fn(&mut Guards);
        let switches: [(Set, u8); 2] =
            [(|it| it.service_switch = true, 1), (|it| it.mains = Mains::Hz60, 2)];
        for (set, bit) in switches {
            with_sample(|mut calibration| {
                let (mut before, mut after) = ([0; MAX_SIZE], [0; MAX_SIZE]);
                let without = encode(&calibration, &mut before).expect("it is small");
                set(&mut calibration.guards);
                let with = encode(&calibration, &mut after).expect("it is small");
                assert_eq!(decode(with), Ok(calibration));
                // All but the CRC at the end.
                let bytes = without.iter().zip(with).take(without.len() - 4);
                let mut changed = bytes.enumerate().filter(|(_, (a, b))| a != b);
                assert_eq!((changed.next(), changed.next()), (Some((578, (&0, &bit))), None));
            });
        }
        // Bit 2 of the switches.
        let field = (11_u32 | 4 << 16).to_le_bytes();
        let mut reader = Reader::new(&field, 0);
        let read = RejoinAndSwitches::get(&mut reader);
        assert!(matches!(reader.finish(read.0), Err(BlobError::Limit { .. })));
    }

    #[test]
    fn a_direction_is_taken_whose_parts_are_rounded_and_not_one_that_is_longer() {
        // (0.48, 0.6, −0.64) has a length of 1, right to 10⁻⁶.
        for (off, is_taken) in [(0.0, true), (1e-7, true), (1e-2, false), (-1e-2, false)] {
            with_sample(|mut calibration| {
                let part = |part: f64| ((part + off) * f64::from(Direction::ONE)) as i32;
                calibration.kinematics.zero = Direction([0.48, 0.6, -0.64].map(part));
                let mut bytes = [0; MAX_SIZE];
                let blob = encode(&calibration, &mut bytes).expect("it is small");
                assert_eq!(decode(blob) == Ok(calibration), is_taken, "{off}");
            });
        }
    }
}
