//! The fields that are quantities, numbers of things, and tables of core.

use trueup_core::{
    calibration::{ElongationSource, MainsFrequency},
    cnc::LinearAxis,
    curve::Curve,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    displacement_sensor::{SensorLaw, SensorSlope},
    gradient::Gradient,
    kinematics::RotaryAxis,
    lag::SmoothingFactor,
    pitch_table::PitchErrorTable,
    reversal::Interval,
    temperature_rate::MAX_RATE_DECIKELVIN_PER_MIN,
    thermal::ThermalExpansionLaw,
    thermometer::Thermometer,
    tool_direction::ToolDirection,
    units::{FineNanometres, Nanometres, Position, SensorReading, Temperature},
    warmup::WarmupModel,
};

use super::{
    blob_codec::{Field, Reader, Writer, fields, numbers},
    blob_format::{
        MAX_COLD_TOLERANCE, MAX_LEARNED_LIMITS, MAX_OFFSET_NM, MAX_REJOIN_NM_PER_S, NO_INDEX,
    },
    error::BlobError,
};

/// How far the square of the tool direction's length may be from 1, in 2⁻⁶⁰: 2⁻¹⁹. The length is
/// then right to 10⁻⁶, 1 nm of a millimetre; rounding to 2⁻³⁰ alone makes 2·10⁻⁹.
const SQUARED_LENGTH_TOLERANCE_Q60: u64 = 1 << 41;

numbers! {
    Nanometres: i32,
    FineNanometres: i32,
    Position: i32,
    Temperature: i32,
    SensorReading: i32,
    SensorSlope: i32,
    Gradient: i32,
    SmoothingFactor: u32,
}

fields!(SensorLaw { k0: Nanometres, zero: SensorReading, slope: SensorSlope });

fields!(WarmupModel {
    lag_ms: u32,
    max: FineNanometres,
    smoothing_heating: SmoothingFactor,
    smoothing_cooling: SmoothingFactor,
    full: i32,
});

/// The largest offset on an axis, 0 nm…[`MAX_OFFSET_NM`].
pub(super) struct MaxOffset(pub Nanometres);

impl<'b> Field<'b> for MaxOffset {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        self.0.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let max = Nanometres::read(from);
        if !(0..=MAX_OFFSET_NM).contains(&max.0) {
            from.reject(BlobError::MaxOffset { offset, found: max.0 });
        }
        Self(max)
    }
}

/// A number of a limit, at most `MAX`.
pub(super) struct BoundedU32<const MAX: u32>(pub u32);

impl<'b, const MAX: u32> Field<'b> for BoundedU32<MAX> {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        self.0.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let found = u32::read(from);
        if found > MAX {
            from.reject(BlobError::Limit { offset, found, most: MAX });
        }
        Self(found)
    }
}

/// Within how much the thermometers of a cold machine agree, 0 K…[`MAX_COLD_TOLERANCE`].
pub(super) struct ColdTolerance(pub Temperature);

impl<'b> Field<'b> for ColdTolerance {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        self.0.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let within = Temperature::read(from);
        if !(Temperature(0)..=MAX_COLD_TOLERANCE).contains(&within) {
            let most = MAX_COLD_TOLERANCE.0.cast_unsigned();
            from.reject(BlobError::Limit { offset, found: within.0.cast_unsigned(), most });
        }
        Self(within)
    }
}

/// The way back from one source to another, up to [`MAX_REJOIN_NM_PER_S`], and switches in the upper half: bit 0 is the
/// service switch, bit 1 says that the mains have 60 Hz. They are 0 in a blob from before they were known, and a firmware from then refuses one that sets them.
pub(super) struct RejoinAndSwitches(pub u32, pub bool, pub MainsFrequency);

impl<'b> Field<'b> for RejoinAndSwitches {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        let switch = if self.1 { SERVICE_SWITCH_FLAG } else { 0 };
        let mains = if self.2 == MainsFrequency::Hz60 { MAINS_60_HZ_FLAG } else { 0 };
        (self.0 | switch | mains).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let found = u32::read(from);
        let rejoin = found & !(SERVICE_SWITCH_FLAG | MAINS_60_HZ_FLAG);
        if rejoin > MAX_REJOIN_NM_PER_S {
            from.reject(BlobError::Limit { offset, found: rejoin, most: MAX_REJOIN_NM_PER_S });
        }
        let mains =
            if found & MAINS_60_HZ_FLAG == 0 { MainsFrequency::Hz50 } else { MainsFrequency::Hz60 };
        Self(rejoin, found & SERVICE_SWITCH_FLAG != 0, mains)
    }
}

/// The bit of the service switch.
const SERVICE_SWITCH_FLAG: u32 = 1 << 16;
/// The bit of mains of 60 Hz.
const MAINS_60_HZ_FLAG: u32 = 1 << 17;

/// Bytes of a text: a reference to them.
pub(super) struct Text<'b>(pub &'b [u8]);

impl<'b> Field<'b> for Text<'b> {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_table(self.0.as_chunks::<1>().0);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self(from.read_records::<1>().as_flattened())
    }
}

impl<'b> Field<'b> for ToolDirection {
    const SIZE: usize = 12;

    fn write(&self, to: &mut Writer<'_>) {
        self.0.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        const UNIT_SQUARED_LENGTH_Q60: u64 = 1 << (2 * ToolDirection::FRACTION_BITS);
        let offset = from.at;
        let components: [i32; 3] = Field::read(from);
        let squares =
            components.map(|component| u64::from(component.unsigned_abs()).saturating_pow(2));
        let length_squared = squares.into_iter().fold(0, u64::saturating_add);
        if length_squared.abs_diff(UNIT_SQUARED_LENGTH_Q60) > SQUARED_LENGTH_TOLERANCE_Q60 {
            from.reject(BlobError::NotUnit { offset, found: components });
        }
        Self(components)
    }
}

/// The first and the second axis that turn the tool, and the caps of what was learned of the growth and of
/// the axes: four bytes. The caps are 0 in a blob from before they were known: nothing may be changed.
pub(super) struct HeadAxesAndLearnedLimits(pub [Option<RotaryAxis>; 2], pub [u8; 2]);

impl<'b> Field<'b> for HeadAxesAndLearnedLimits {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        let [first, second] = self.0.map(encode_rotary_axis);
        let [growth, axes] = self.1;
        to.write_bytes(&[first, second, growth, axes]);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [first, second, growth, axes] = from.read_bytes();
        let caps = [
            from.check_limit(growth, MAX_LEARNED_LIMITS.growth),
            from.check_limit(axes, MAX_LEARNED_LIMITS.axes),
        ];
        let turning = [first, second].map(|number| decode_rotary_axis(number, offset, from));
        Self(turning, caps)
    }
}

/// Returns the number of a rotary axis; 0 of none.
pub(super) const fn encode_rotary_axis(axis: Option<RotaryAxis>) -> u8 {
    match axis {
        None => 0,
        Some(RotaryAxis::A) => 1,
        Some(RotaryAxis::B) => 2,
        Some(RotaryAxis::C) => 3,
    }
}

/// Returns the rotary axis with this number, which stands at `offset`; none of 0.
pub(super) fn decode_rotary_axis(
    number: u8,
    offset: usize,
    from: &mut Reader<'_>,
) -> Option<RotaryAxis> {
    match number {
        0 => None,
        1 => Some(RotaryAxis::A),
        2 => Some(RotaryAxis::B),
        3 => Some(RotaryAxis::C),
        found => from.reject_value(offset, found),
    }
}

/// The sources of the elongation in their order, and the cap of what was learned of its zero: four bytes.
pub(super) struct SourceChainAndLearnedLimit(pub [Option<ElongationSource>; 3], pub u8);

impl<'b> Field<'b> for SourceChainAndLearnedLimit {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        let [first, second, third] = self.0.map(|source| match source {
            None => 0,
            Some(ElongationSource::Sensor) => 1,
            Some(ElongationSource::Temperature) => 2,
            Some(ElongationSource::Warmup) => 3,
        });
        to.write_bytes(&[first, second, third, self.1]);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [first, second, third, zero] = from.read_bytes();
        let zero = from.check_limit(zero, MAX_LEARNED_LIMITS.zero);
        let sources = [first, second, third].map(|number| match number {
            0 => None,
            1 => Some(ElongationSource::Sensor),
            2 => Some(ElongationSource::Temperature),
            3 => Some(ElongationSource::Warmup),
            found => from.reject_value(offset, found),
        });
        Self(sources, zero)
    }
}

/// A temperature channel, if there is one.
pub(super) struct OptionalChannel(pub Option<u8>);

impl<'b> Field<'b> for OptionalChannel {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        self.0.map_or(NO_INDEX, u32::from).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        Self(match u32::read(from) {
            NO_INDEX => None,
            found => match u8::try_from(found) {
                Ok(channel) if usize::from(channel) < TEMPERATURE_CHANNEL_COUNT => Some(channel),
                _ => from.reject_value(offset, found),
            },
        })
    }
}

/// A linear axis, if there is one.
impl<'b> Field<'b> for Option<LinearAxis> {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        self.map_or(NO_INDEX, |axis| axis as u32).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        match u32::read(from) {
            NO_INDEX => None,
            found => decode_linear_axis(found).or_else(|| from.reject_value(offset, found)),
        }
    }
}

/// Returns the axis with this number.
pub(super) const fn decode_linear_axis(number: u32) -> Option<LinearAxis> {
    match number {
        0 => Some(LinearAxis::X),
        1 => Some(LinearAxis::Y),
        2 => Some(LinearAxis::Z),
        _ => None,
    }
}

/// The thermometer of a temperature channel, and how fast it may change: kind, shift, two bytes of the rate, zero,
/// slope. The rate is 0 in a blob from before it was known: the default.
pub(super) struct ThermometerAndRateLimit(pub Option<Thermometer>, pub u16);

impl<'b> Field<'b> for ThermometerAndRateLimit {
    const SIZE: usize = 12;

    fn write(&self, to: &mut Writer<'_>) {
        let (kind, shift, zero, slope) = match self.0 {
            None => (0, 0, 0, 0),
            Some(Thermometer::Pt100) => (1, 0, 0, 0),
            Some(Thermometer::Linear { zero, slope, shift }) => (2, shift, zero, slope),
        };
        let [low, high] = self.1.to_le_bytes();
        to.write_bytes(&[kind, shift, low, high]);
        [zero, slope].write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let [kind, shift, low, high] = from.read_bytes();
        let rate = u16::from_le_bytes([low, high]);
        if rate > MAX_RATE_DECIKELVIN_PER_MIN {
            from.reject(BlobError::Limit {
                offset,
                found: rate.into(),
                most: MAX_RATE_DECIKELVIN_PER_MIN.into(),
            });
        }
        let (zero, slope) = (i32::read(from), i32::read(from));
        let thermometer = match kind {
            0 => None,
            1 => Some(Thermometer::Pt100),
            2 => Some(Thermometer::Linear { zero, slope, shift }),
            found => from.reject_value(offset, found),
        };
        Self(thermometer, rate)
    }
}

impl<'b> Field<'b> for Interval {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        self.length().write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self::new(u32::read(from))
    }
}

impl<'b> Field<'b> for ThermalExpansionLaw<'b> {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_table(self.pieces);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self { pieces: from.read_records() }
    }
}

impl<'b> Field<'b> for Curve<'b> {
    const SIZE: usize = 16;

    fn write(&self, to: &mut Writer<'_>) {
        to.write_table(self.segments());
        to.write_table(self.index());
        self.first_knot().write(to);
        u32::from(self.bucket_shift()).write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let (segments, index) = (from.read_records(), from.read_records());
        let first = Position::read(from);
        let shift = u32::read(from);
        let bucket_shift = u8::try_from(shift).ok().or_else(|| from.reject_value(offset, shift));
        let curve = Self::new(first, segments, index, bucket_shift.unwrap_or_default());
        if !curve.is_consistent() {
            from.reject(BlobError::Table { offset });
        }
        curve
    }
}

/// A pitch table, if there is one: without points there is none.
impl<'b> Field<'b> for Option<PitchErrorTable<'b>> {
    const SIZE: usize = 16;

    fn write(&self, to: &mut Writer<'_>) {
        let Some(pitch) = self else { return [0_u32; 4].write(to) };
        pitch.start.write(to);
        pitch.step.write(to);
        to.write_table(pitch.forward);
        to.write_table(pitch.reverse.unwrap_or_default());
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let (start, step) = (Position::read(from), u32::read(from));
        let (forward, reverse) = (from.read_records(), from.read_records());
        if forward.is_empty() {
            return None;
        }
        let reverse = (!reverse.is_empty()).then_some(reverse);
        let pitch = PitchErrorTable { start, step: Interval::new(step), forward, reverse };
        if !pitch.is_consistent() {
            from.reject(BlobError::Table { offset });
        }
        Some(pitch)
    }
}

#[cfg(test)]
mod tests;
