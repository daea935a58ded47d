//! Is the sensor alive? A look at the raw codes before they reach the filter.
//!
//! Four ways in which a sensor lies, each from its own sign:
//! - **At a rail**: a broken wire pulls the divider to 0 V, a short or a dead supply to full scale.
//!   A single code at a rail is a spike: the last good code stands in for it. Four in a row are a
//!   fault, and so is more than a fifth of all codes; it clears after 10 ms of good codes.
//! - **Frozen**: a code that does not change for 200 ms, or has not since the start, is a hung converter or a
//!   disconnected chain; but only where a live one must show: by run-out while the spindle turns, or by its noise
//!   where it was lively before. Of a quiet sensor whose spindle stands it proves nothing. Blocks with a
//!   change are weighed against blocks without: noise of 0.3 codes RMS leaves 14 % without at the most (in
//!   the middle of a code it passes its edges by one reading in ten), and a sensor is lively once the first have
//!   outweighed the others for a second. When the spindle stops, that has to be shown anew, unless noise alone is
//!   beyond what run-out without any could leave: a smooth curve in whole codes has second differences of 20
//!   codes² a block, noise of half a code has 40.
//! - **Wild**: a code farther from the last good one than anything on a machine moves in 50 µs ([`MAX_CODE_STEP`]). Up to three are a
//!   spike, and the last good code stands in for them. Four that follow from each other are another level: that is
//!   believed, because it may be true, and reported for 100 ms ([`SensorHealthMonitor::has_jumped`]). Codes that follow from nothing
//!   are no sensor's: twenty of them, and more than a fifth of all, are a fault until 10 ms are good.
//!   It is looked for only in a block whose second differences stand out of those before; a step before the analogue
//!   low-pass of 2 kHz does from some 30 µm on, and one below is as smooth as a machine that shakes.
//!
//! The noise is measured on the way, from second differences, because they pass over growth and
//! run-out and keep the noise: their variance is six times that of the codes.
//!
//! All of it is tested a block at a time. An ordinary block, no code of which is at a rail and none wild, needs no
//! counter for single codes and goes to the filter where it lies: 304 instructions (`cargo
//! measure`), where counters for each code took 1,023.

use crate::{design_parameters::CODES_PER_TICK, units::AdcCode};

/// Codes up to here are at the lower rail: 20 mV of 10 V.
pub const LOW_RAIL: AdcCode = AdcCode(8);
/// Codes from here on are at the upper rail.
pub const HIGH_RAIL: AdcCode = AdcCode(4087);
/// This many codes at a rail in a row are a fault, fewer are spikes.
pub const RAIL_FAULT_CODES: u16 = 4;
/// A code at a rail outweighs this many good ones: a sensor that lies at a rail in more than a fifth of
/// its codes is there, and noise takes it off at times.
const BAD_CODE_WEIGHT: u16 = 4;
const RAIL_FAULT_LEVEL: u16 = RAIL_FAULT_CODES * BAD_CODE_WEIGHT;
/// This many good codes in a row end a fault: 10 ms.
pub const RECOVERY_CODES: u16 = 200;
/// Within it a code follows from the one before, 50 µs ago: 32 codes are 3.9 µm, or 78 mm/s. Run-out of 5 µm at 24,000
/// r/min makes 5, and two readings with a noise of three codes RMS are 27 apart once in 10¹⁰.
pub const MAX_CODE_STEP: u16 = 32;
/// A level is another one, and no spike, once this many codes have followed from its first.
const MIN_CODES_AT_NEW_LEVEL: u8 = 3;
/// This many wild codes, less a fourth of the good ones, are a fault: a step of the whole range has ten, in which the
/// analogue low-pass takes it there.
const OUTLIER_FAULT_CODES: u16 = 20;
const OUTLIER_FAULT_LEVEL: u16 = OUTLIER_FAULT_CODES * BAD_CODE_WEIGHT;
/// A jump is reported until this many codes have been good: 100 ms, many turns of what looks for it.
const JUMP_REPORT_CODES: u16 = 2_000;

/// The squared second differences of a block stand out above this many times their mean. By noise alone with a
/// probability below e^(4.7 − 12·120/40) = 10⁻¹³ (Chernoff, over the eigenvalues of the squares' form, 16 at the most).
const OUTLIER_FACTOR: u32 = 12;
/// And above those of a machine that shakes by 10 µm at 1 kHz, twice: 82 codes·(2π·50 µs·1 kHz)² are 8 codes each way.
const VIBRATION_ALLOWANCE_SQUARES: u32 = 1_280;
/// More than this counts as this in the mean: twice what noise of three codes RMS has, so that a wild sensor does not
/// become the measure of itself.
const MAX_SQUARES_IN_MEAN: u32 = 2_400;

/// This many equal codes in a row are a frozen converter: 200 ms.
pub const FROZEN_AFTER_CODES: u16 = 4_000;

/// A sensor is not known to be lively: this many blocks with a change have to outweigh those without, 1 s.
const MAX_STILL_BLOCKS: u16 = 1_000;
/// Up to here it is: below the blocks of a freeze that is being counted, and above what the still blocks of
/// noise of 0.3 codes reach by chance (a walk that steps up with 14 %: (0.14/0.86)⁴⁰ = 10⁻³²).
const MAX_LIVELY_STILL_BLOCKS: u16 = FROZEN_AFTER_CODES / CODES_PER_BLOCK + 40;

/// Blocks over which the squared second differences are averaged, as a power of two.
const MEAN_BLOCKS_LOG2: u32 = 6;
/// Twice what any run-out without noise leaves, as [`SensorHealthMonitor::liveliness`] has it.
const MIN_LIVELY_SQUARES: u32 = 40 << MEAN_BLOCKS_LOG2;

/// The state of the check from block to block.
#[derive(Clone, Debug)]
pub struct SensorHealthMonitor {
    good: AdcCode,
    /// Codes at a rail, [`BAD_CODE_WEIGHT`] each, less the good ones.
    at_rail: u16,
    /// Wild codes, the same way.
    wild: u16,
    /// Good codes since one was not, or since a jump.
    good_since: u16,
    /// Too many at a rail, or wild.
    lost: bool,
    /// Wild codes that have followed from each other so far.
    following: u8,
    jumped: bool,
    /// How often in a row the last code has come again.
    equal: u16,
    /// Blocks without a change less those with one; stands while it is frozen.
    still: u16,
    frozen: bool,
    /// Whether the spindle turned at the last block.
    turned: bool,
    /// The squared second differences of a block, averaged over 64 of them, Q6.
    liveliness: u32,
    /// The last two codes.
    before: [AdcCode; 2],
    /// Whether there has been a block yet.
    begun: bool,
    /// Whether the next block begins where that one ended.
    continues: bool,
    noise: NoiseStatistics,
    /// The last block with a code at a rail or a wild one, mended.
    mended: [AdcCode; CODES_PER_TICK],
}

/// Noise of the raw codes since it was last read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoiseStatistics {
    /// Sum of the squared second differences, in codes squared.
    pub squares: u32,
    /// How many there are. The RMS noise in codes is √(squares / (6·count)).
    pub count: u32,
}

impl Default for SensorHealthMonitor {
    fn default() -> Self {
        Self {
            good: AdcCode::default(),
            at_rail: 0,
            wild: 0,
            good_since: 0,
            lost: false,
            following: 0,
            jumped: false,
            equal: 0,
            still: MAX_STILL_BLOCKS,
            frozen: false,
            turned: false,
            // Nothing stands out before the mean is known.
            liveliness: MAX_SQUARES_IN_MEAN << MEAN_BLOCKS_LOG2,
            before: [AdcCode::default(); 2],
            begun: false,
            continues: false,
            noise: NoiseStatistics::default(),
            mended: [AdcCode::default(); CODES_PER_TICK],
        }
    }
}

impl SensorHealthMonitor {
    /// Looks at one tick of codes; `turns`: the spindle does, so that run-out must show. Gives the codes for the filter, spikes replaced, or `None`
    /// while the sensor cannot be believed.
    #[inline(never)]
    pub fn check_and_clean_codes<'c>(
        &'c mut self,
        codes: &'c [AdcCode; CODES_PER_TICK],
        turns: bool,
    ) -> Option<&'c [AdcCode; CODES_PER_TICK]> {
        if self.turned && !turns && self.liveliness < MIN_LIVELY_SQUARES {
            self.still = MAX_STILL_BLOCKS;
        }
        if turns && !self.turned {
            // How long a quiet sensor stood still before says nothing of one whose spindle starts.
            self.equal = 0;
        }
        self.turned = turns;
        self.count_equal_codes(codes);
        let squares = sum_squared_second_differences(self.before, codes);
        // After a gap the first two say nothing.
        let squares = if self.continues { squares } else { squares.and(Some(0)) };
        let is_ordinary = squares.is_some_and(|squares| squares <= self.outlier_threshold());
        let [_, before] = self.before;
        self.accumulate_noise(codes, squares);
        if is_ordinary {
            self.accept_normal_block(codes);
        } else {
            self.replace_outliers(codes, before);
        }
        // Before the first good code there is nothing that could stand in for a spike.
        let blind = self.good == AdcCode(0);
        let believable = !self.lost && !blind && !self.frozen;
        believable.then_some(if is_ordinary { codes } else { &self.mended })
    }

    /// The codes that come next do not begin where the last ones ended: some are missing.
    pub fn record_gap(&mut self) {
        self.continues = false;
        self.following = 0;
    }

    /// Returns whether the sensor was somewhere else of late than anything on a machine gets in so short a time, and
    /// stayed.
    #[must_use]
    pub const fn has_jumped(&self) -> bool {
        self.jumped && self.good_since < JUMP_REPORT_CODES
    }

    /// Returns the noise since the last call.
    pub fn take_noise_statistics(&mut self) -> NoiseStatistics {
        core::mem::take(&mut self.noise)
    }

    /// Squares of a block above this stand out.
    #[inline]
    fn outlier_threshold(&self) -> u32 {
        const LIVELINESS_DIVISOR: u32 = (1 << MEAN_BLOCKS_LOG2) / 4;
        // The mean is below 2²¹.
        (self.liveliness / LIVELINESS_DIVISOR)
            .wrapping_mul(OUTLIER_FACTOR / 4)
            .wrapping_add(VIBRATION_ALLOWANCE_SQUARES)
    }

    /// A block without a code at a rail, and without a wild one.
    fn accept_normal_block(&mut self, codes: &[AdcCode; CODES_PER_TICK]) {
        let [.., last] = codes;
        self.good = *last;
        self.at_rail = self.at_rail.saturating_sub(CODES_PER_BLOCK);
        self.wild = self.wild.saturating_sub(CODES_PER_BLOCK);
        self.good_since = self.good_since.saturating_add(CODES_PER_BLOCK);
        self.lost &= self.good_since < RECOVERY_CODES;
    }

    /// Code by code, for a block with a code at a rail, or with one that may be wild.
    #[cold]
    #[inline(never)]
    fn replace_outliers(&mut self, codes: &[AdcCode; CODES_PER_TICK], mut before: AdcCode) {
        self.jumped = self.has_jumped();
        // Straight to their place: a copy of all codes takes longer than the loop.
        for (number, &now) in codes.iter().enumerate() {
            let mut mended = now;
            let follows = is_plausible_step(before, now);
            let is_sought = self.lost || self.good == AdcCode(0);
            let is_good = !is_at_rail(now)
                && if is_sought {
                    follows || is_at_rail(before)
                } else {
                    self.accept_code(now, follows)
                };
            before = now;
            if is_good {
                self.good = now;
                self.following = 0;
                self.at_rail = self.at_rail.saturating_sub(1);
                self.wild = self.wild.saturating_sub(1);
                self.good_since = self.good_since.saturating_add(1);
            } else {
                let (count, most) = if is_at_rail(now) {
                    (&mut self.at_rail, RAIL_FAULT_LEVEL)
                } else {
                    (&mut self.wild, OUTLIER_FAULT_LEVEL)
                };
                *count = count.saturating_add(BAD_CODE_WEIGHT).min(most);
                self.good_since = 0;
                mended = self.good;
            }
            if let Some(place) = self.mended.get_mut(number) {
                *place = mended;
            }
            if self.at_rail >= RAIL_FAULT_LEVEL || self.wild >= OUTLIER_FAULT_LEVEL {
                self.lost = true;
            } else if self.good_since >= RECOVERY_CODES {
                self.lost = false;
            }
        }
        if self.following > 0 {
            // Another level may have begun with the last codes. The next block, as smooth on it as any, is to be looked at.
            self.before = [self.good; 2];
        }
    }

    /// Returns whether a code goes on from the last good one, or is the last that another level needs.
    fn accept_code(&mut self, now: AdcCode, follows: bool) -> bool {
        if is_plausible_step(self.good, now) {
            return true;
        }
        self.following = if follows { self.following.saturating_add(1) } else { 0 };
        let is_level = self.following >= MIN_CODES_AT_NEW_LEVEL;
        if is_level {
            (self.jumped, self.good_since) = (true, 0);
        }
        is_level
    }

    /// Counts from the end: of a live converter the first pair or two differ.
    fn count_equal_codes(&mut self, codes: &[AdcCode; CODES_PER_TICK]) {
        let [.., last] = codes;
        let again = codes.iter().rev().skip(1).take_while(|code| *code == last).count();
        let [_, before] = self.before;
        let again = u16::try_from(again).unwrap_or(CODES_PER_BLOCK);
        if again.saturating_add(1) < CODES_PER_BLOCK {
            self.equal = again;
            self.frozen = false;
            self.still = self.still.saturating_sub(1);
            return;
        }
        if self.begun && before == *last {
            // The whole block, and the code before it as well.
            self.equal = self.equal.saturating_add(CODES_PER_BLOCK);
        } else {
            // At the start it is frozen until a code has changed.
            self.frozen = !self.begun;
            self.equal = CODES_PER_BLOCK.saturating_sub(1);
        }
        if self.equal >= FROZEN_AFTER_CODES {
            self.frozen |= self.turned || self.still <= MAX_LIVELY_STILL_BLOCKS;
        } else {
            self.still = self.still.saturating_add(1).min(MAX_STILL_BLOCKS);
        }
    }

    /// Adds the squared second differences of a block; `None`: a code is at a rail, which is no noise.
    fn accumulate_noise(&mut self, codes: &[AdcCode; CODES_PER_TICK], squares: Option<u32>) {
        let [.., last_but_one, last] = codes;
        if let Some(squares) = squares.filter(|_| self.continues) {
            let newest = squares.min(MAX_SQUARES_IN_MEAN);
            self.liveliness = self
                .liveliness
                .wrapping_sub(self.liveliness >> MEAN_BLOCKS_LOG2)
                .wrapping_add(newest);
            self.noise.squares = self.noise.squares.saturating_add(squares);
            self.noise.count = self.noise.count.saturating_add(CODES_PER_BLOCK.into());
        }
        self.before = [*last_but_one, *last];
        (self.begun, self.continues) = (true, true);
    }
}

/// Returns the sum of the squared second differences of a block, the first two of which begin in the block `before`;
/// `None` if a code is at a rail: one pass answers both.
#[inline]
fn sum_squared_second_differences(
    before: [AdcCode; 2],
    codes: &[AdcCode; CODES_PER_TICK],
) -> Option<u32> {
    let mut window = before;
    let sum = codes.iter().try_fold(0_u64, |squares, code| {
        // 34 bits each.
        let sum = squared_second_difference(window, *code).wrapping_add(squares);
        window = [window[1], *code];
        (!is_at_rail(*code)).then_some(sum)
    });
    sum.map(|sum| u32::try_from(sum).unwrap_or(u32::MAX))
}

/// Codes in a block.
#[allow(clippy::cast_possible_truncation, reason = "20")]
const CODES_PER_BLOCK: u16 = CODES_PER_TICK as u16;

/// Returns whether a code means a broken wire or a short: one comparison for both rails.
#[inline]
fn is_at_rail(code: AdcCode) -> bool {
    const MIN_VALID_CODE: u32 = LOW_RAIL.0 as u32 + 1;
    const MAX_VALID_CODE: u32 = HIGH_RAIL.0 as u32 - 1;
    u32::from(code.0).wrapping_sub(MIN_VALID_CODE) > MAX_VALID_CODE - MIN_VALID_CODE
}

/// Returns whether one code can follow from another.
#[inline]
fn is_plausible_step(a: AdcCode, b: AdcCode) -> bool {
    a.0.abs_diff(b.0) <= MAX_CODE_STEP
}

/// Returns the squared second difference of three codes.
#[inline]
fn squared_second_difference([older, old]: [AdcCode; 2], new: AdcCode) -> u64 {
    let [older, old, new] = [older, old, new].map(|code| i32::from(code.0));
    let curve = i64::from(new.wrapping_sub(old).wrapping_sub(old.wrapping_sub(older)));
    curve.wrapping_mul(curve).cast_unsigned()
}

#[cfg(test)]
mod tests;
