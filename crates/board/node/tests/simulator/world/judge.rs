//! Conditions that hold in every tick, whatever fails: limits, no step, quality and age that are true, and
//! the offset that the machine needs.

use trueup_core::cnc::{OffsetQuality, Output};

use super::{World, WorldFault};
use crate::machine::{MAX_NM, SLEW_NM_PER_MS};

impl World {
    /// Checks the conditions of every tick, whatever happens.
    pub(super) fn judge(&mut self, elapsed_ms: u32, output: &Output) {
        let place = || {
            format!("seed {}, tick {}, {:?}: {output:?}", self.seed, self.seen.ticks, self.fault)
        };
        let offset = output.offset.map(|offset| offset.map(|axis| axis.0));
        // Not available and Fault are one.
        assert_eq!(offset.is_none(), output.quality == OffsetQuality::Fault, "{}", place());
        // Nothing before the engage sequence.
        if !self.engaged_after_release {
            assert_eq!(offset, None, "before the engage sequence: {}", place());
        }
        let Some(offset) = offset else {
            self.joined = None;
            return;
        };
        // Limits.
        assert!(offset.iter().all(|nm| nm.abs() <= MAX_NM), "beyond its limit: {}", place());
        // No step, whatever comes, goes, or takes over; from "not available" it begins at 0.
        let before = self
            .before
            .and_then(|before| before.offset)
            .map_or([0; 3], |offset| offset.map(|axis| axis.0));
        let most = SLEW_NM_PER_MS * elapsed_ms as i32;
        for (nm, before) in offset.iter().zip(before) {
            assert!((nm - before).abs() <= most, "a step from {before}: {}", place());
        }
        if output.quality == OffsetQuality::Off {
            assert_eq!(offset, [0; 3], "{}", place());
        }
        // Live says that the sensor is there.
        let is_blind = matches!(
            self.fault,
            WorldFault::SensorOpen
                | WorldFault::BothOpen
                | WorldFault::SensorShort
                | WorldFault::SensorRail
                | WorldFault::NoBlocks
                | WorldFault::FewBlocks
        );
        // After a start it has to be found anew.
        let lasts = self.lasts_ms().min(self.since_start_ms);
        if is_blind && lasts > 50 || self.fault == WorldFault::SensorStuck && lasts > 250 {
            assert_ne!(output.quality, OffsetQuality::Live, "blind for {lasts} ms: {}", place());
            assert_ne!(output.flags.0 & 0x0C, 0, "not reported: {}", place());
        }
        // Nor a model that its thermometer is there, once its channel counts as bad.
        if self.fault == WorldFault::BothOpen && lasts > 1_600 {
            assert_ne!(output.quality, OffsetQuality::TemperatureModel, "{}", place());
        }
        // Followed and held end in time; what is followed is as old as it says.
        if is_on(output.quality) {
            assert!(self.control_ms <= 520, "no Control for {} ms: {}", self.control_ms, place());
            let received_ms = self.axis.received_ms;
            assert!(received_ms <= 520, "no position for {received_ms} ms: {}", place());
            let sampled_ms = match output.quality {
                OffsetQuality::Live => self.block_ms,
                OffsetQuality::TemperatureModel => self.temperatures_ms,
                _ => 0,
            };
            let oldest_ms = sampled_ms.max(if self.axis.moves { received_ms } else { 0 });
            let reported_ms = u32::from(output.age_ms);
            // A reading of the filter may be a window's turn older than its newest sample.
            // And blocks that do not come are noticed within a turn of the supervisor, 10 ms.
            let least_ms = oldest_ms.saturating_sub(self.untold_ms.min(20));
            let range = least_ms.min(255)..=oldest_ms.saturating_add(21);
            assert!(range.contains(&reported_ms), "{reported_ms} ms for {oldest_ms}: {}", place());
        }
        if self.fault == WorldFault::CncSilent && lasts > 2_530 {
            assert_ne!(output.quality, OffsetQuality::Hold, "for {lasts} ms: {}", place());
        }
        self.joins(elapsed_ms, output, offset[2]);
        self.compare(output, offset);
    }

    /// A change of source leaves the offset where it was, but for what the machine has grown by. (A
    /// sensor that freezes elsewhere has reported it for 200 ms, and a `Zero` in the same millisecond sets off for
    /// 0: neither is looked at here.)
    fn joins(&mut self, elapsed_ms: u32, output: &Output, z_nm: i32) {
        let before = self.before.map(|before| before.quality);
        let has_changed = before.is_some_and(|before| before != output.quality && is_on(before));
        if !is_on(output.quality)
            || self.fault == WorldFault::SensorStuck
            || self.zero_tick == self.seen.ticks
        {
            self.joined = None;
        } else if has_changed && self.before.is_some_and(|before| before.flags.0 & 0x03 == 0) {
            self.joined = Some((z_nm, 0));
        }
        if let Some((joined_nm, ms)) = self.joined {
            let moved = (z_nm - joined_nm).abs();
            // A second of growth of either model, and as much again.
            assert!(moved <= 2_000, "{moved} nm in {ms} ms of a new source: {}", self.place());
            self.joined = (ms < 1_000).then_some((joined_nm, ms + elapsed_ms));
        }
    }

    /// While it is live, settled and well, the offset is what the machine has grown by.
    fn compare(&mut self, output: &Output, [x_nm, _, z_nm]: [i32; 3]) {
        let is_settled = output.quality == OffsetQuality::Live && output.flags.0 & 0x0F == 0;
        self.well_ms =
            if is_settled && self.fault == WorldFault::None { self.well_ms + 1 } else { 0 };
        if self.well_ms < 1_000 {
            return;
        }
        if let Some([grown_nm, error_nm]) = self.zeroed[self.table].truth_nm {
            let truth = (self.spindle.grown_nm() - grown_nm).round() as i32;
            let off = (z_nm - truth).abs();
            self.seen.worst_live_nm = self.seen.worst_live_nm.max(off);
            // Noise of a code or so at the reference and now, a tick of growth, half a code of rounding.
            assert!(off <= 250, "off by {off} nm: {}", self.place());
            let error = self.axis.error_nm(self.table).expect("it is live");
            let off = f64::from(x_nm) + (error - error_nm);
            assert!(off.abs() <= 2.0, "X is off by {off} nm: {}", self.place());
        }
    }
}

fn is_on(quality: OffsetQuality) -> bool {
    matches!(
        quality,
        OffsetQuality::Live | OffsetQuality::TemperatureModel | OffsetQuality::WarmUpModel
    )
}
