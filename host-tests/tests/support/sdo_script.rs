//! Frames of a CANopen master, as lines of the chip model's script.

/// From one request to the next; the bridge answers every 2 ms.
pub const STEP_MS: f64 = 2.2;

/// Returns the frames of a segmented download into an object (CiA 301, 7.2.4.3.3), and when the last is sent.
pub fn download((index, subindex): (u16, u8), bytes: &[u8], from_ms: f64) -> (String, f64) {
    let count = bytes.chunks(7).count();
    let [low, high] = index.to_le_bytes();
    let size = u32::try_from(bytes.len()).expect("short").to_le_bytes();
    let head = hex(&[0x21, low, high, subindex]);
    let mut script = format!("{from_ms} frame 601 {head}{}\n", hex(&size));
    let mut at = from_ms;
    for (number, part) in bytes.chunks(7).enumerate() {
        at += STEP_MS;
        let head = (number & 1) << 4 | (7 - part.len()) << 1 | usize::from(number + 1 == count);
        let mut data = vec![head as u8];
        data.extend(part);
        data.resize(8, 0);
        script += &format!("{at:.1} frame 601 {}\n", hex(&data));
    }
    (script, at)
}

/// Returns the frames that read objects, one every 4 ms.
pub fn questions(objects: &[(u16, u8)], from_ms: f64) -> String {
    let requested = objects.iter().enumerate();
    requested
        .map(|(n, (index, subindex))| {
            let [low, high] = index.to_le_bytes();
            let request = hex(&[0x40, low, high, *subindex, 0, 0, 0, 0]);
            format!("{} frame 601 {request}\n", from_ms + 4.0 * n as f64)
        })
        .collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
