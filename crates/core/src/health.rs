//! Is the sensor alive? A look at the raw codes before they reach the filter.
//!
//! Three ways in which a sensor lies, each from its own sign:
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
//!
//! The noise is measured on the way, from second differences, because they pass over growth and
//! run-out and keep the noise: their variance is six times that of the codes.
//!
//! All of it is asked a block at a time. An ordinary block, no code of which is at a rail, needs no
//! counter for single codes and goes to the filter where it lies: 309 instructions (`cargo
//! measure`), where counters for each code took 1,023.

use crate::{dimensions::CODES_PER_TICK, units::Code};

/// Codes up to here are at the lower rail: 20 mV of 10 V.
pub const LOW_RAIL: Code = Code(8);
/// Codes from here on are at the upper rail.
pub const HIGH_RAIL: Code = Code(4087);
/// So many codes at a rail in a row are a fault, fewer are spikes.
pub const FAULT_AFTER_CODES: u16 = 4;
/// A code at a rail outweighs so many good ones: a sensor that lies at a rail in more than a fifth of
/// its codes is there, and noise takes it off at times.
const GOOD_PER_RAIL: u16 = 4;
const RAILED: u16 = FAULT_AFTER_CODES * GOOD_PER_RAIL;
/// So many good codes in a row end a fault: 10 ms.
pub const GOOD_AFTER_CODES: u16 = 200;
/// So many equal codes in a row are a frozen converter: 200 ms.
pub const FROZEN_AFTER_CODES: u16 = 4_000;

/// A sensor is not known to be lively: so many blocks with a change have to outweigh those without, 1 s.
const NOT_LIVELY: u16 = 1_000;
/// Up to here it is: below the blocks of a freeze that is being counted, and above what the still blocks of
/// noise of 0.3 codes reach by chance (a walk that steps up with 14 %: (0.14/0.86)⁴⁰ = 10⁻³²).
const LIVELY: u16 = FROZEN_AFTER_CODES / BLOCK + 40;

/// Twice what any run-out without noise leaves, as [`Health::liveliness`] has it.
const LIVELY_BY_NOISE: u32 = 40 << 6;

/// What is remembered from block to block.
#[derive(Clone, Debug)]
pub struct Health {
    good: Code,
    /// Codes at a rail, [`GOOD_PER_RAIL`] each, less the good ones.
    at_rail: u16,
    not_at_rail: u16,
    railed: bool,
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
    before: [Code; 2],
    /// Whether there has been a block yet.
    begun: bool,
    noise: Noise,
    /// The last block with a code at a rail, mended.
    mended: [Code; CODES_PER_TICK],
}

/// Noise of the raw codes since it was last asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Noise {
    /// Sum of the squared second differences, in codes squared.
    pub squares: u32,
    /// How many there are. The RMS noise in codes is √(squares / (6·count)).
    pub count: u32,
}

impl Default for Health {
    fn default() -> Self {
        Self {
            good: Code::default(),
            at_rail: 0,
            not_at_rail: 0,
            railed: false,
            equal: 0,
            still: NOT_LIVELY,
            frozen: false,
            turned: false,
            liveliness: 0,
            before: [Code::default(); 2],
            begun: false,
            noise: Noise::default(),
            mended: [Code::default(); CODES_PER_TICK],
        }
    }
}

impl Health {
    /// Looks at one tick of codes; `turns`: the spindle does, so that run-out must show. Gives the codes for the filter, spikes replaced, or `None`
    /// while the sensor cannot be believed.
    #[inline(never)]
    pub fn check<'c>(
        &'c mut self,
        codes: &'c [Code; CODES_PER_TICK],
        turns: bool,
    ) -> Option<&'c [Code; CODES_PER_TICK]> {
        if self.turned && !turns && self.liveliness < LIVELY_BY_NOISE {
            self.still = NOT_LIVELY;
        }
        if turns && !self.turned {
            // How long a quiet sensor stood still before says nothing of one whose spindle starts.
            self.equal = 0;
        }
        self.turned = turns;
        self.count_equal(codes);
        let squares = ordinary_squares(codes);
        if squares.is_some() {
            self.take_ordinary(codes);
        } else {
            self.mend(codes);
        }
        self.measure_noise(codes, squares.unwrap_or_else(|| all_squares(codes)));
        // Before the first good code there is nothing that could stand in for a spike.
        let blind = self.good == Code(0);
        let believable = !self.railed && !blind && !self.frozen;
        believable.then_some(if squares.is_some() { codes } else { &self.mended })
    }

    /// The noise since the last call.
    pub fn take_noise(&mut self) -> Noise {
        core::mem::take(&mut self.noise)
    }

    /// A block without a code at a rail.
    fn take_ordinary(&mut self, codes: &[Code; CODES_PER_TICK]) {
        let [.., last] = codes;
        self.good = *last;
        self.at_rail = self.at_rail.saturating_sub(BLOCK);
        self.not_at_rail = self.not_at_rail.saturating_add(BLOCK);
        self.railed &= self.not_at_rail < GOOD_AFTER_CODES;
    }

    /// Code by code, for a block with a code at a rail.
    #[cold]
    #[inline(never)]
    fn mend(&mut self, codes: &[Code; CODES_PER_TICK]) {
        self.mended = *codes;
        for code in &mut self.mended {
            if is_at_rail(*code) {
                self.not_at_rail = 0;
                self.at_rail = self.at_rail.saturating_add(GOOD_PER_RAIL).min(RAILED);
                *code = self.good;
            } else {
                self.at_rail = self.at_rail.saturating_sub(1);
                self.not_at_rail = self.not_at_rail.saturating_add(1);
                self.good = *code;
            }
            if self.at_rail >= RAILED {
                self.railed = true;
            } else if self.not_at_rail >= GOOD_AFTER_CODES {
                self.railed = false;
            }
        }
    }

    /// Counts from the end: of a live converter the first pair or two differ.
    fn count_equal(&mut self, codes: &[Code; CODES_PER_TICK]) {
        let [.., last] = codes;
        let again = codes.iter().rev().skip(1).take_while(|code| *code == last).count();
        let [_, before] = self.before;
        let again = u16::try_from(again).unwrap_or(BLOCK);
        if again.saturating_add(1) < BLOCK {
            self.equal = again;
            self.frozen = false;
            self.still = self.still.saturating_sub(1);
            return;
        }
        if self.begun && before == *last {
            // The whole block, and the code before it as well.
            self.equal = self.equal.saturating_add(BLOCK);
        } else {
            // At the start it is frozen until a code has changed.
            self.frozen = !self.begun;
            self.equal = BLOCK.saturating_sub(1);
        }
        if self.equal >= FROZEN_AFTER_CODES {
            self.frozen |= self.turned || self.still <= LIVELY;
        } else {
            self.still = self.still.saturating_add(1).min(NOT_LIVELY);
        }
    }

    /// Adds the second differences of a block: the first two, which begin in the block before, and
    /// the squares of the others.
    fn measure_noise(&mut self, codes: &[Code; CODES_PER_TICK], mut squares: u64) {
        let [first, second, .., last_but_one, last] = codes;
        let mut count = BLOCK.saturating_sub(2);
        if self.begun {
            let [_, before] = self.before;
            squares = squares
                .wrapping_add(square(self.before, *first))
                .wrapping_add(square([before, *first], *second));
            count = BLOCK;
        }
        let squares = u32::try_from(squares).unwrap_or(u32::MAX);
        let newest = squares.min(u16::MAX.into());
        self.liveliness = self.liveliness.wrapping_sub(self.liveliness >> 6).wrapping_add(newest);
        self.noise.squares = self.noise.squares.saturating_add(squares);
        self.noise.count = self.noise.count.saturating_add(count.into());
        self.before = [*last_but_one, *last];
        self.begun = true;
    }
}

/// The sum of the squared second differences inside a block; `None` if a code is at a rail. One
/// pass answers both. A square takes 34 bits, so that the sum cannot wrap.
#[inline]
fn ordinary_squares(codes: &[Code; CODES_PER_TICK]) -> Option<u64> {
    let [first, second, rest @ ..] = codes;
    if is_at_rail(*first) || is_at_rail(*second) {
        return None;
    }
    let mut window = [*first, *second];
    rest.iter().try_fold(0_u64, |squares, code| {
        let sum = squares.wrapping_add(square(window, *code));
        window = [window[1], *code];
        (!is_at_rail(*code)).then_some(sum)
    })
}

/// The same sum, whatever the codes.
#[cold]
fn all_squares(codes: &[Code; CODES_PER_TICK]) -> u64 {
    let [first, second, rest @ ..] = codes;
    let mut window = [*first, *second];
    rest.iter().fold(0, |squares, code| {
        let sum = square(window, *code).wrapping_add(squares);
        window = [window[1], *code];
        sum
    })
}

/// Codes in a block.
#[allow(clippy::cast_possible_truncation, reason = "20")]
const BLOCK: u16 = CODES_PER_TICK as u16;

/// Whether a code tells a broken wire or a short: one comparison for both rails.
#[inline]
fn is_at_rail(code: Code) -> bool {
    const LOWEST: u32 = LOW_RAIL.0 as u32 + 1;
    const HIGHEST: u32 = HIGH_RAIL.0 as u32 - 1;
    u32::from(code.0).wrapping_sub(LOWEST) > HIGHEST - LOWEST
}

/// The squared second difference of three codes.
#[inline]
fn square([older, old]: [Code; 2], new: Code) -> u64 {
    let [older, old, new] = [older, old, new].map(|code| i32::from(code.0));
    let curve = i64::from(new.wrapping_sub(old).wrapping_sub(old.wrapping_sub(older)));
    curve.wrapping_mul(curve).cast_unsigned()
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    /// Codes that never repeat, around `level`.
    fn lively(level: u16) -> [Code; CODES_PER_TICK] {
        core::array::from_fn(|n| Code(level + (n % 2) as u16))
    }

    #[test]
    fn a_spike_is_replaced_by_the_last_good_code() {
        let mut health = Health::default();
        let mut codes = lively(700);
        codes[5] = Code(4095);
        codes[6] = Code(0);
        let clean = health.check(&codes, false).expect("two codes are a spike");
        assert_eq!(clean[5], codes[4]);
        assert_eq!(clean[6], codes[4]);
        assert_eq!(clean[7], codes[7]);
    }

    #[test]
    fn four_codes_at_a_rail_are_a_fault_until_10_ms_are_good() {
        for rail in [Code(0), Code(8), Code(4087), Code(4095)] {
            let mut health = Health::default();
            assert!(health.check(&lively(700), false).is_some());
            let mut codes = lively(700);
            codes[..3].fill(rail);
            assert!(health.check(&codes, false).is_some(), "three are not yet a fault");
            codes[..4].fill(rail);
            assert!(health.check(&codes, false).is_none(), "four are");
            let blind = (0..).take_while(|_| health.check(&lively(700), false).is_none()).count();
            // 16 good codes came with the fault.
            assert_eq!(blind * CODES_PER_TICK, 180);
        }
    }

    #[test]
    fn a_sensor_at_the_rail_that_noise_takes_off_at_times_is_a_fault() {
        for pattern in [&[0, 0, 0, 20][..], &[0, 20], &[0, 0, 20, 20], &[4095, 4000, 4095]] {
            let mut health = Health::default();
            assert!(health.check(&lively(700), false).is_some());
            let codes = core::array::from_fn(|n| Code(pattern[n % pattern.len()]));
            let blind = (0..20)
                .map(|_| health.check(&codes, false).is_none())
                .collect::<std::vec::Vec<_>>();
            assert!(blind[2..].iter().all(|it| *it), "{pattern:?}: {blind:?}");
        }
        // A spike in twenty codes is none.
        let mut health = Health::default();
        let mut codes = lively(700);
        codes[7] = Code(0);
        assert!((0..1_000).all(|_| health.check(&codes, false).is_some()));
    }

    #[test]
    fn a_board_that_starts_with_a_broken_wire_is_blind() {
        let mut health = Health::default();
        for _ in 0..100 {
            assert!(health.check(&[Code(0); CODES_PER_TICK], false).is_none());
        }
    }

    #[test]
    fn a_frozen_converter_is_found_after_200_ms_and_a_lively_one_never() {
        let mut health = Health::default();
        assert!(
            (0..300).all(|_| health.check(&[Code(700); CODES_PER_TICK], false).is_none()),
            "from the start"
        );
        let before = (0..1_000).take_while(|_| health.check(&lively(700), false).is_some());
        assert_eq!(before.count(), 1_000);
        let alive =
            (0..).take_while(|_| health.check(&[Code(701); CODES_PER_TICK], false).is_some());
        assert_eq!(alive.count(), 199, "the last code of the block before is the same");
        assert!(health.check(&lively(700), false).is_some(), "one change ends it");
        for _ in 0..1000 {
            assert!(health.check(&lively(700), false).is_some());
        }
    }

    #[test]
    fn a_quiet_sensor_is_not_frozen_and_neither_is_one_whose_spindle_has_stopped() {
        let mut health = Health::default();
        // A change in ten blocks: noise far below 0.3 codes, and then none for seconds.
        for n in 0..10_000 {
            let code = if n % 10 == 0 { lively(700) } else { [Code(701); CODES_PER_TICK] };
            assert!(health.check(&code, false).is_some(), "at {n}");
        }
        assert!((0..10_000).all(|_| health.check(&[Code(701); CODES_PER_TICK], false).is_some()));
        // Run-out of ±10 codes without any noise, and then a spindle that stands.
        let mut health = Health::default();
        for ms in 0..5_000_u32 {
            let codes = core::array::from_fn(|n| {
                let angle = (f64::from(ms) + n as f64 / 20.0) * 0.2 * core::f64::consts::TAU;
                Code((700.0 + 10.0 * angle.sin()).round() as u16)
            });
            assert!(health.check(&codes, true).is_some());
        }
        assert!((0..10_000).all(|_| health.check(&[Code(701); CODES_PER_TICK], false).is_some()));
        // And turns again, without a change: that is no spindle, once run-out must have shown.
        let starts = (0..)
            .take_while(|_| health.check(&[Code(701); CODES_PER_TICK], true).is_some())
            .count();
        assert_eq!(starts, 199, "the last code before is the same");
    }

    #[test]
    fn noise_is_measured_through_growth_and_run_out() {
        // ±1 code alternating has an RMS of 1 and second differences of ±4, where white noise of
        // the same RMS has √6: so the estimate of this stream is 4/√6.
        let mut health = Health::default();
        let codes = core::array::from_fn(|n| Code(if n % 2 == 0 { 999 } else { 1001 }));
        health.check(&codes, false);
        health.take_noise();
        health.check(&codes, false);
        let noise = health.take_noise();
        assert_eq!((noise.squares, noise.count), (20 * 16, 20));
        assert_eq!(health.take_noise(), Noise::default());
    }

    #[test]
    fn the_codes_next_to_the_rails_are_a_measurement() {
        for edge in [9, 4086] {
            let mut health = Health::default();
            assert!(health.check(&lively(700), false).is_some());
            // Alive, and at the edge in every other code.
            let inside = if edge == 9 { 10 } else { 4085 };
            let codes = core::array::from_fn(|n| Code(if n % 2 == 0 { edge } else { inside }));
            for _ in 0..100 {
                assert_eq!(health.check(&codes, false), Some(&codes), "{edge}");
            }
        }
    }
}
