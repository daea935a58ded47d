//! A part of a circle, or several turns of it, from where the axes stand.
//!
//! Angles count from the first axis of the plane to the second, as those of a circle that is read: X to Y (G17), Y to Z
//! (G19), Z to X (G18). Plus is counter-clockwise, G3.

/// The way of two axes around a centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcMove {
    /// The axes of the plane, the first and the second: 0, 1, 2 of X, Y, Z.
    pub axes: [usize; 2],
    /// Its centre in mm.
    pub centre_mm: [f64; 2],
    /// How far it turns in degrees: above 0 counter-clockwise; whole turns, or less than one.
    pub turn_deg: f64,
    /// A reading is taken at each whole degree of the turn from the first to the second, counted without sign.
    pub read_deg: [u32; 2],
    /// Along the circle, above 0.
    pub feed_mm_per_min: f64,
}

impl ArcMove {
    /// Returns +1 counter-clockwise, −1 clockwise.
    #[must_use]
    pub fn rotation_sign(&self) -> f64 {
        self.turn_deg.signum()
    }

    /// Returns the place after a turn of `turned_deg` degrees, counted without sign.
    #[must_use]
    pub fn position_mm(&self, start_mm: [f64; 2], turned_deg: f64) -> [f64; 2] {
        let (sin, cos) = (self.rotation_sign() * turned_deg).to_radians().sin_cos();
        let [u, v] = [0, 1].map(|n| start_mm[n] - self.centre_mm[n]);
        [self.centre_mm[0] + u * cos - v * sin, self.centre_mm[1] + u * sin + v * cos]
    }

    /// Returns the place where it ends, in whole micrometres; whole turns end where they begin.
    #[must_use]
    pub fn end_mm(&self, start_mm: [f64; 2]) -> [f64; 2] {
        match self.turn_deg % 360.0 == 0.0 {
            true => start_mm,
            false => self.position_mm(start_mm, self.turn_deg.abs()).map(round_to_micrometres),
        }
    }

    /// Returns the turns of its blocks in degrees: each a whole turn or less.
    #[must_use]
    pub fn block_angles_deg(&self) -> Vec<f64> {
        let whole = (self.turn_deg.abs() / 360.0).floor() as usize;
        let rest = self.turn_deg % 360.0;
        let mut blocks = vec![360.0 * self.rotation_sign(); whole];
        blocks.extend((rest != 0.0).then_some(rest));
        blocks
    }

    /// Returns its length in mm.
    #[must_use]
    pub fn length_mm(&self, start_mm: [f64; 2]) -> f64 {
        self.radius_mm(start_mm) * self.turn_deg.abs().to_radians()
    }

    fn radius_mm(&self, start_mm: [f64; 2]) -> f64 {
        (start_mm[0] - self.centre_mm[0]).hypot(start_mm[1] - self.centre_mm[1])
    }

    /// Returns the lowest and the highest place of both axes.
    #[must_use]
    pub fn extent_mm(&self, start_mm: [f64; 2]) -> [[f64; 2]; 2] {
        let radius = self.radius_mm(start_mm);
        let first = (start_mm[1] - self.centre_mm[1]).atan2(start_mm[0] - self.centre_mm[0]);
        let end = self.end_mm(start_mm);
        // The four places at which an axis turns round, where the way passes them.
        let passes = |deg: f64| {
            let ahead = (self.rotation_sign() * (deg - first.to_degrees())).rem_euclid(360.0);
            // The start itself is an end of the way.
            ahead <= self.turn_deg.abs()
        };
        [0, 1].map(|n| {
            let turns = 90.0 * n as f64;
            let centre = self.centre_mm[n];
            let mut places = vec![start_mm[n], end[n]];
            places.extend(passes(turns).then_some(centre + radius));
            places.extend(passes(turns + 180.0).then_some(centre - radius));
            let low = places.iter().copied().fold(f64::INFINITY, f64::min);
            let high = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            [round_to_micrometres(low), round_to_micrometres(high)]
        })
    }

    /// Returns the direction of both axes on arrival, after a turn of `turned_deg` degrees: 1, −1.
    #[must_use]
    pub fn direction(&self, start_mm: [f64; 2], turned_deg: f64) -> [i8; 2] {
        /// Distance before a place, in degrees: at a reversal an axis stands.
        const DIRECTION_STEP_DEG: f64 = 0.01;
        let at = self.position_mm(start_mm, turned_deg - DIRECTION_STEP_DEG);
        let [u, v] = [0, 1].map(|n| at[n] - self.centre_mm[n]);
        [-v * self.rotation_sign(), u * self.rotation_sign()]
            .map(|component| if component < 0.0 { -1 } else { 1 })
    }
}

/// As a control takes it: whole micrometres.
pub(crate) fn round_to_micrometres(mm: f64) -> f64 {
    (mm * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arc(turn_deg: f64) -> ArcMove {
        let centre_mm = [100.0, 50.0];
        ArcMove { axes: [0, 1], centre_mm, turn_deg, read_deg: [2, 218], feed_mm_per_min: 500.0 }
    }

    #[test]
    fn a_turn_reaches_all_four_ends_and_a_part_of_it_those_that_it_passes() {
        let whole = arc(-720.0);
        assert_eq!(whole.extent_mm([150.0, 50.0]), [[50.0, 150.0], [0.0, 100.0]]);
        assert_eq!(whole.end_mm([150.0, 50.0]), [150.0, 50.0]);
        assert_eq!(whole.block_angles_deg(), [-360.0, -360.0]);
        // From 20° below the first axis over the top to 20° below its other end.
        let start_mm = [20.0_f64.to_radians().cos(), -20.0_f64.to_radians().sin()];
        let start_mm =
            [100.0 + 50.0 * start_mm[0], 50.0 + 50.0 * start_mm[1]].map(round_to_micrometres);
        let part = arc(220.0);
        assert_eq!(part.extent_mm(start_mm), [[50.0, 150.0], [32.899, 100.0]]);
        assert_eq!(part.end_mm(start_mm), [round_to_micrometres(200.0 - start_mm[0]), start_mm[1]]);
        assert_eq!(arc(-220.0).end_mm(part.end_mm(start_mm)), start_mm);
        assert_eq!(part.block_angles_deg(), [220.0]);
    }

    #[test]
    fn directions_are_those_of_the_way_to_a_place() {
        let start_mm = [150.0, 50.0];
        let found =
            [0.0, 45.0, 90.0, 180.0, 270.0, 360.0].map(|deg| arc(360.0).direction(start_mm, deg));
        // Counter-clockwise from the end of the first axis; at a reversal that of before.
        assert_eq!(found, [[1, 1], [-1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]);
        assert_eq!(arc(-360.0).direction(start_mm, 45.0), [-1, -1]);
        assert_eq!(arc(-360.0).rotation_sign(), -1.0);
    }
}
