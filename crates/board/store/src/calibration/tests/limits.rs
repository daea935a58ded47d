//! Limits and the caps of what was learned, written and read again.

use super::*;

#[test]
fn caps_lie_where_a_blob_from_before_has_0_and_lets_nothing_be_changed() {
    let before = sample();
    let calibration = decode(&before).expect("one");
    assert_eq!(calibration.limits.learned, LearnedLimits::default());
    let mut room = [0; MAX_BLOB_SIZE];
    let caps = LearnedLimits { growth: 250, axes: 30, zero: 200 };
    let mut permits = calibration;
    permits.limits.learned = caps;
    let blob = encode(&permits, &mut room).expect("as large");
    assert_eq!((blob[46], blob[47], blob[51]), (250, 30, 200));
    assert_eq!(decode(blob), Ok(permits));
    let differs = before.iter().zip(blob).filter(|(a, b)| a != b).count();
    assert!(blob.len() == before.len() && differs <= 3 + CRC_SIZE, "{differs}");
}

#[test]
fn each_limit_comes_back_up_to_its_largest_and_one_more_is_refused() {
    type Set = fn(&mut CompensationLimits, u32);
    let set: [(Set, u32); 4] = [
        (|limits, value| limits.slew_nm_per_s = value, MAX_SLEW_NM_PER_S),
        (|limits, value| limits.link_timeout_ms = value, MAX_LINK_TIMEOUT_MS),
        (|limits, value| limits.hold_ms = value, MAX_HOLD_MS),
        (|limits, value| limits.rejoin_nm_per_s = value, MAX_REJOIN_NM_PER_S),
    ];
    for (set, most) in set {
        for (value, is_taken) in [(most, true), (most + 1, false)] {
            with_sample(|mut calibration| {
                set(&mut calibration.limits, value);
                let mut bytes = [0; MAX_BLOB_SIZE];
                let decoded = decode(encode(&calibration, &mut bytes).expect("it is small"));
                let is_refused = matches!(decoded, Err(BlobError::Limit { found, most: limit, .. })
                    if found == value && limit == most);
                assert_eq!((decoded == Ok(calibration), is_refused), (is_taken, !is_taken));
            });
        }
    }
}
