//! The errors of the volume: one record, whose curves follow it. It stands among the terms as one of its
//! own kind, so that a calibration without it has the bytes that it always had, and an older firmware
//! refuses one with it by that kind.

use trueup_core::{
    curve::Curve,
    gradient::Gradient,
    kinematics::RotaryAxis,
    units::{Fine, Position},
    volume::{Angle, AngularErrors, Chain, MAX_ARM, RotaryLocation, Volume},
};

use super::{
    error::BlobError,
    quantities::{linear_axis, rotary_axis, rotary_number},
    wire::{Field, Reader, Writer, fields},
};

/// Its kind among the terms.
pub(super) const KIND: u8 = 18;

fields!(Angle<'b> { slope: Gradient, curve: Curve<'b> });
fields!(AngularErrors<'b> { point: [Position; 3], about: [Angle<'b>; 3] });

/// Writes the reference to the record, and the record with its curves.
pub(super) fn put(volume: &Volume<'_>, to: &mut Writer<'_>) {
    let place = to.table(&[[0_u8; Volume::SIZE]]);
    to.elsewhere(place, |to| volume.put(to));
}

/// Reads the record that the next reference names.
pub(super) fn get<'b>(from: &mut Reader<'b>) -> Option<Volume<'b>> {
    let offset = from.at;
    let records = from.table::<{ Volume::SIZE }>();
    if records.len() != 1 {
        from.refuse(BlobError::Table { offset });
        return None;
    }
    let start = from.elsewhere(offset, u32::get) & 0xFFFF;
    Some(from.elsewhere(usize::try_from(start).unwrap_or(usize::MAX), Volume::get))
}

impl<'b> Field<'b> for Volume<'b> {
    const SIZE: usize = 312;

    fn put(&self, to: &mut Writer<'_>) {
        self.chain.put(to);
        self.guides.put(to);
        self.tool.put(to);
        self.rotary.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        Self {
            chain: Chain::get(from),
            guides: Field::get(from),
            tool: arm(from),
            rotary: Field::get(from),
        }
    }
}
const _: () = assert!(
    Volume::SIZE == Chain::SIZE + 3 * AngularErrors::SIZE + 12 + 2 * Option::<RotaryLocation>::SIZE
);

/// The axes from the workpiece to the tool, a byte each, and how many of them move the workpiece.
impl<'b> Field<'b> for Chain {
    const SIZE: usize = 4;

    fn put(&self, to: &mut Writer<'_>) {
        let [first, second, third] = self.order().map(|axis| axis as u8);
        to.bytes(&[first, second, third, self.on_workpiece()]);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let bytes = from.bytes();
        let [first, second, third, on_workpiece] = bytes;
        let axes = [first, second, third].map(|number| linear_axis(number.into()));
        let order = match axes {
            [Some(first), Some(second), Some(third)] => Some([first, second, third]),
            _ => None,
        };
        let chain = order.and_then(|order| Self::new(order, on_workpiece));
        chain.or_else(|| from.refuse_value(offset, u32::from_le_bytes(bytes))).unwrap_or_default()
    }
}

/// Axis and side in a word, 0 for none; point, shift, tilt.
impl<'b> Field<'b> for Option<RotaryLocation> {
    const SIZE: usize = 40;

    fn put(&self, to: &mut Writer<'_>) {
        let Some(it) = self else { return [[0_i32; 2]; 5].put(to) };
        to.bytes(&[rotary_number(Some(it.axis)), it.moves_workpiece.into(), 0, 0]);
        it.point.put(to);
        it.shift.put(to);
        it.tilt.put(to);
    }

    fn get(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let word = from.bytes();
        let [number, side, rest @ ..] = word;
        if side > 1 || rest != [0; 2] {
            from.refuse_value::<()>(offset, u32::from_le_bytes(word));
        }
        let axis: Option<RotaryAxis> = rotary_axis(number, offset, from);
        let point = arm(from);
        let (shift, tilt): ([Fine; 3], [Fine; 3]) = (Field::get(from), Field::get(from));
        axis.map(|axis| RotaryLocation { axis, moves_workpiece: side == 1, point, shift, tilt })
    }
}

/// Reads a vector that may be turned.
fn arm(from: &mut Reader<'_>) -> [Position; 3] {
    let offset = from.at;
    let arm: [Position; 3] = Field::get(from);
    let most = MAX_ARM.unsigned_abs();
    if let Some(found) = arm.iter().map(|it| it.0.unsigned_abs()).find(|it| *it > most) {
        from.refuse(BlobError::Limit { offset, found, most });
    }
    arm
}

#[cfg(test)]
mod tests;
