//! The errors of the volume: one record, whose curves follow it. It stands among the terms as one of its
//! own kind, so that a calibration without it has the bytes that it always had, and an older firmware
//! refuses one with it by that kind.

use trueup_core::{
    curve::Curve,
    gradient::Gradient,
    kinematics::RotaryAxis,
    units::{FineNanometres, Position},
    volumetric_error::{
        AngularErrorCurve, AngularErrors, KinematicChain, MAX_LEVER_ARM, RotaryAxisLocation,
        VolumetricErrorModel,
    },
};

use super::{
    blob_codec::{Field, Reader, Writer, fields},
    blob_fields::{decode_linear_axis, decode_rotary_axis, encode_rotary_axis},
    error::BlobError,
};

/// Its kind among the terms.
pub(super) const VOLUMETRIC_TERM_KIND: u8 = 18;

fields!(AngularErrorCurve<'b> { slope: Gradient, curve: Curve<'b> });
fields!(AngularErrors<'b> { point: [Position; 3], about: [AngularErrorCurve<'b>; 3] });

/// Writes the reference to the record, and the record with its curves.
pub(super) fn write_volumetric_errors(volume: &VolumetricErrorModel<'_>, to: &mut Writer<'_>) {
    let place = to.write_table(&[[0_u8; VolumetricErrorModel::SIZE]]);
    to.write_at(place, |to| volume.write(to));
}

/// Reads the record that the next reference names.
pub(super) fn read_volumetric_errors<'b>(
    from: &mut Reader<'b>,
) -> Option<VolumetricErrorModel<'b>> {
    let offset = from.at;
    let records = from.read_records::<{ VolumetricErrorModel::SIZE }>();
    if records.len() != 1 {
        from.reject(BlobError::Table { offset });
        return None;
    }
    let start = from.read_at(offset, u32::read) & 0xFFFF;
    Some(from.read_at(usize::try_from(start).unwrap_or(usize::MAX), VolumetricErrorModel::read))
}

impl<'b> Field<'b> for VolumetricErrorModel<'b> {
    const SIZE: usize = 312;

    fn write(&self, to: &mut Writer<'_>) {
        self.chain.write(to);
        self.guides.write(to);
        self.tool.write(to);
        self.rotary.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        Self {
            chain: KinematicChain::read(from),
            guides: Field::read(from),
            tool: read_lever_arm(from),
            rotary: Field::read(from),
        }
    }
}
const _: () = assert!(
    VolumetricErrorModel::SIZE
        == KinematicChain::SIZE
            + 3 * AngularErrors::SIZE
            + 12
            + 2 * Option::<RotaryAxisLocation>::SIZE
);

/// The axes from the workpiece to the tool, a byte each, and how many of them move the workpiece.
impl<'b> Field<'b> for KinematicChain {
    const SIZE: usize = 4;

    fn write(&self, to: &mut Writer<'_>) {
        let [first, second, third] = self.order().map(|axis| axis as u8);
        to.write_bytes(&[first, second, third, self.workpiece_axis_count()]);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let bytes = from.read_bytes();
        let [first, second, third, on_workpiece] = bytes;
        let axes = [first, second, third].map(|number| decode_linear_axis(number.into()));
        let order = match axes {
            [Some(first), Some(second), Some(third)] => Some([first, second, third]),
            _ => None,
        };
        let chain = order.and_then(|order| Self::new(order, on_workpiece));
        chain.or_else(|| from.reject_value(offset, u32::from_le_bytes(bytes))).unwrap_or_default()
    }
}

/// Axis and side in a word, 0 for none; point, shift, tilt.
impl<'b> Field<'b> for Option<RotaryAxisLocation> {
    const SIZE: usize = 40;

    fn write(&self, to: &mut Writer<'_>) {
        let Some(it) = self else { return [[0_i32; 2]; 5].write(to) };
        to.write_bytes(&[encode_rotary_axis(Some(it.axis)), it.moves_workpiece.into(), 0, 0]);
        it.point.write(to);
        it.shift.write(to);
        it.tilt.write(to);
    }

    fn read(from: &mut Reader<'b>) -> Self {
        let offset = from.at;
        let word = from.read_bytes();
        let [number, side, rest @ ..] = word;
        if side > 1 || rest != [0; 2] {
            from.reject_value::<()>(offset, u32::from_le_bytes(word));
        }
        let axis: Option<RotaryAxis> = decode_rotary_axis(number, offset, from);
        let point = read_lever_arm(from);
        let (shift, tilt): ([FineNanometres; 3], [FineNanometres; 3]) =
            (Field::read(from), Field::read(from));
        axis.map(|axis| RotaryAxisLocation { axis, moves_workpiece: side == 1, point, shift, tilt })
    }
}

/// Reads a vector that may be turned.
fn read_lever_arm(from: &mut Reader<'_>) -> [Position; 3] {
    let offset = from.at;
    let arm: [Position; 3] = Field::read(from);
    let most = MAX_LEVER_ARM.unsigned_abs();
    if let Some(found) =
        arm.iter().map(|component| component.0.unsigned_abs()).find(|component| *component > most)
    {
        from.reject(BlobError::Limit { offset, found, most });
    }
    arm
}

#[cfg(test)]
mod tests;
