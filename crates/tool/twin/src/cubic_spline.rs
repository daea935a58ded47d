//! A smooth curve through points: the natural cubic spline.
//!
//! Between two points it is a cubic; value, slope and curvature are continuous, and the curvature is 0
//! at both ends. With h_i the distance from point i to the next, the curvatures M solve
//!
//! ```text
//! h_{i−1}·M_{i−1} + 2·(h_{i−1} + h_i)·M_i + h_i·M_{i+1} = 6·((y_{i+1} − y_i)/h_i − (y_i − y_{i−1})/h_{i−1})
//! ```

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Deserializer, de::Error as _};

/// A curve through points; held outside them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CubicSpline {
    points: Vec<[f64; 2]>,
    curvatures: Vec<f64>,
}

impl CubicSpline {
    /// Through `points`, each a place and a value.
    ///
    /// # Errors
    /// Places that do not rise.
    pub fn from_points(points: Vec<[f64; 2]>) -> Result<Self, String> {
        for pair in points.windows(2) {
            let ([before, _], [after, _]) = (pair[0], pair[1]);
            if after.is_nan() || before.is_nan() || after <= before {
                return Err(format!("{after} is not above {before}: the places must rise"));
            }
        }
        let count = points.len();
        let mut curvatures = vec![0.0; count];
        // Thomas's elimination over the inner points; what is left of each row is kept in `above`.
        let mut above = vec![0.0; count];
        for i in 1..count.saturating_sub(1) {
            let (h0, h1) = (points[i][0] - points[i - 1][0], points[i + 1][0] - points[i][0]);
            let bend = 6.0
                * ((points[i + 1][1] - points[i][1]) / h1 - (points[i][1] - points[i - 1][1]) / h0);
            let pivot = 2.0 * (h0 + h1) - h0 * above[i - 1];
            above[i] = h1 / pivot;
            curvatures[i] = (bend - h0 * curvatures[i - 1]) / pivot;
        }
        for i in (1..count.saturating_sub(1)).rev() {
            curvatures[i] -= above[i] * curvatures[i + 1];
        }
        Ok(Self { points, curvatures })
    }

    /// Returns the value at `place`; 0 of a curve without points.
    ///
    /// ```
    /// use trueup_twin::cubic_spline::CubicSpline;
    /// let hump = CubicSpline::from_points(vec![[0.0, 0.0], [10.0, 4.0], [20.0, 0.0]]).expect("it rises");
    /// // M = (0, −0.12, 0): half way 0.5·0 + 0.5·4 + ((0.5³ − 0.5)·(0 − 0.12))·10²/6 = 2.75
    /// assert!((hump.evaluate(5.0) - 2.75).abs() < 1e-12);
    /// assert_eq!(hump.evaluate(99.0), 0.0);
    /// ```
    #[must_use]
    pub fn evaluate(&self, place: f64) -> f64 {
        let above = self.points.partition_point(|point| point[0] <= place);
        let Some(below) = above.checked_sub(1) else {
            return self.points.first().map_or(0.0, |point| point[1]);
        };
        let Some(&[x1, y1]) = self.points.get(above) else { return self.points[below][1] };
        let [x0, y0] = self.points[below];
        let h = x1 - x0;
        let (b, a) = ((place - x0) / h, (x1 - place) / h);
        let bend =
            (a * a * a - a) * self.curvatures[below] + (b * b * b - b) * self.curvatures[above];
        a * y0 + b * y1 + bend * h * h / 6.0
    }
}

impl<'de> Deserialize<'de> for CubicSpline {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_points(Vec::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

impl JsonSchema for CubicSpline {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "points".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        Vec::<[f64; 2]>::json_schema(generator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_through_its_points_and_a_straight_line_stays_straight() {
        let points = vec![[-3.0, 1.0], [0.0, 5.0], [2.0, -1.0], [7.0, 2.0]];
        let curve = CubicSpline::from_points(points.clone()).expect("it rises");
        for [place, value] in points {
            assert!((curve.evaluate(place) - value).abs() < 1e-12);
        }
        let line =
            CubicSpline::from_points(vec![[0.0, 1.0], [1.0, 3.0], [4.0, 9.0]]).expect("it rises");
        assert!((line.evaluate(2.7) - 6.4).abs() < 1e-12);
    }

    #[test]
    fn places_must_rise() {
        let error =
            CubicSpline::from_points(vec![[0.0, 0.0], [0.0, 1.0]]).expect_err("they do not");
        assert_eq!(error, "0 is not above 0: the places must rise");
    }
}
