//! SHA-256 and SHA-512 (FIPS 180-4), in one form, small and without a path that panics.
//!
//! The usual crate, `sha2`, does not fit: unrolled, its SHA-512 alone is 26 KB of the 32 that the boot program has;
//! compact, its SHA-256 takes 97 cycles a byte on the Cortex-M4, and a start with the largest image 190 ms. Here
//! SHA-256, which goes over the image, is unrolled by sixteen rounds; SHA-512, which a signature needs for half a
//! kilobyte, is a loop. The tests hold both against `sha2`.
//!
//! The constants of SHA-256 are the upper halves of those of SHA-512 (sections 4.2 and 5.3): the first bits of the
//! cube roots, and of the square roots, of the same primes.

/// Section 4.2.3.
const ROUND_CONSTANTS: [u64; 80] = [
    0x428a_2f98_d728_ae22,
    0x7137_4491_23ef_65cd,
    0xb5c0_fbcf_ec4d_3b2f,
    0xe9b5_dba5_8189_dbbc,
    0x3956_c25b_f348_b538,
    0x59f1_11f1_b605_d019,
    0x923f_82a4_af19_4f9b,
    0xab1c_5ed5_da6d_8118,
    0xd807_aa98_a303_0242,
    0x1283_5b01_4570_6fbe,
    0x2431_85be_4ee4_b28c,
    0x550c_7dc3_d5ff_b4e2,
    0x72be_5d74_f27b_896f,
    0x80de_b1fe_3b16_96b1,
    0x9bdc_06a7_25c7_1235,
    0xc19b_f174_cf69_2694,
    0xe49b_69c1_9ef1_4ad2,
    0xefbe_4786_384f_25e3,
    0x0fc1_9dc6_8b8c_d5b5,
    0x240c_a1cc_77ac_9c65,
    0x2de9_2c6f_592b_0275,
    0x4a74_84aa_6ea6_e483,
    0x5cb0_a9dc_bd41_fbd4,
    0x76f9_88da_8311_53b5,
    0x983e_5152_ee66_dfab,
    0xa831_c66d_2db4_3210,
    0xb003_27c8_98fb_213f,
    0xbf59_7fc7_beef_0ee4,
    0xc6e0_0bf3_3da8_8fc2,
    0xd5a7_9147_930a_a725,
    0x06ca_6351_e003_826f,
    0x1429_2967_0a0e_6e70,
    0x27b7_0a85_46d2_2ffc,
    0x2e1b_2138_5c26_c926,
    0x4d2c_6dfc_5ac4_2aed,
    0x5338_0d13_9d95_b3df,
    0x650a_7354_8baf_63de,
    0x766a_0abb_3c77_b2a8,
    0x81c2_c92e_47ed_aee6,
    0x9272_2c85_1482_353b,
    0xa2bf_e8a1_4cf1_0364,
    0xa81a_664b_bc42_3001,
    0xc24b_8b70_d0f8_9791,
    0xc76c_51a3_0654_be30,
    0xd192_e819_d6ef_5218,
    0xd699_0624_5565_a910,
    0xf40e_3585_5771_202a,
    0x106a_a070_32bb_d1b8,
    0x19a4_c116_b8d2_d0c8,
    0x1e37_6c08_5141_ab53,
    0x2748_774c_df8e_eb99,
    0x34b0_bcb5_e19b_48a8,
    0x391c_0cb3_c5c9_5a63,
    0x4ed8_aa4a_e341_8acb,
    0x5b9c_ca4f_7763_e373,
    0x682e_6ff3_d6b2_b8a3,
    0x748f_82ee_5def_b2fc,
    0x78a5_636f_4317_2f60,
    0x84c8_7814_a1f0_ab72,
    0x8cc7_0208_1a64_39ec,
    0x90be_fffa_2363_1e28,
    0xa450_6ceb_de82_bde9,
    0xbef9_a3f7_b2c6_7915,
    0xc671_78f2_e372_532b,
    0xca27_3ece_ea26_619c,
    0xd186_b8c7_21c0_c207,
    0xeada_7dd6_cde0_eb1e,
    0xf57d_4f7f_ee6e_d178,
    0x06f0_67aa_7217_6fba,
    0x0a63_7dc5_a2c8_98a6,
    0x113f_9804_bef9_0dae,
    0x1b71_0b35_131c_471b,
    0x28db_77f5_2304_7d84,
    0x32ca_ab7b_40c7_2493,
    0x3c9e_be0a_15c9_bebc,
    0x431d_67c4_9c10_0d4c,
    0x4cc5_d4be_cb3e_42b6,
    0x597f_299c_fc65_7e2a,
    0x5fcb_6fab_3ad6_faec,
    0x6c44_198c_4a47_5817,
];
/// Section 5.3.5.
const INITIAL_HASH_VALUE: [u64; 8] = [
    0x6a09_e667_f3bc_c908,
    0xbb67_ae85_84ca_a73b,
    0x3c6e_f372_fe94_f82b,
    0xa54f_f53a_5f1d_36f1,
    0x510e_527f_ade6_82d1,
    0x9b05_688c_2b3e_6c1f,
    0x1f83_d9ab_fb41_bd6b,
    0x5be0_cd19_137e_2179,
];

#[allow(
    clippy::cast_possible_truncation,
    clippy::arithmetic_side_effects,
    reason = "the upper half is what is meant, and the compiler works it out"
)]
const fn high_halves<const N: usize, const M: usize>(words: &[u64; M]) -> [u32; N] {
    let mut upper = [0; N];
    let mut n = 0;
    while n < N {
        upper[n] = (words[n] >> 32) as u32;
        n += 1;
    }
    upper
}

/// Section 4.2.2.
static ROUND_CONSTANTS_256: [u32; 64] = high_halves(&ROUND_CONSTANTS);
static ROUND_CONSTANTS_512: [u64; 80] = ROUND_CONSTANTS;

/// The words of one of the two, with blocks of that many bytes.
pub(crate) trait Sha2Word<const BLOCK: usize>: Copy {
    /// The state before the first block.
    const INITIAL_STATE: [Self; 8];

    /// Takes a block into the state.
    fn compress(state: &mut [Self; 8], block: &[u8; BLOCK]);
}

/// A hash that goes on.
#[derive(Clone, Debug)]
pub(crate) struct Hasher<W, const BLOCK: usize> {
    state: [W; 8],
    block: [u8; BLOCK],
    /// Bytes in `block`, fewer than it has.
    used: usize,
    length: u64,
}

/// SHA-256.
pub(crate) type Sha256 = Hasher<u32, 64>;
/// SHA-512.
pub(crate) type Sha512 = Hasher<u64, 128>;

impl<W: Sha2Word<BLOCK>, const BLOCK: usize> Hasher<W, BLOCK> {
    /// Returns the hash of nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { state: W::INITIAL_STATE, block: [0; BLOCK], used: 0, length: 0 }
    }

    /// Takes the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.length = self.length.wrapping_add(bytes.len() as u64);
        let mut rest = bytes;
        if self.used > 0 {
            let room = BLOCK.saturating_sub(self.used);
            let (head, tail) = rest.split_at_checked(room).unwrap_or((rest, &[]));
            self.fill_block(head);
            rest = tail;
        }
        let (blocks, rest) = rest.as_chunks();
        blocks.iter().for_each(|block| W::compress(&mut self.state, block));
        self.fill_block(rest);
    }

    /// Puts bytes into the block; once it is full it is taken.
    fn fill_block(&mut self, bytes: &[u8]) {
        let places = self.block.iter_mut().skip(self.used);
        places.zip(bytes).for_each(|(place, byte)| *place = *byte);
        self.used = self.used.saturating_add(bytes.len());
        if self.used >= BLOCK {
            W::compress(&mut self.state, &self.block);
            self.used = 0;
        }
    }

    /// Pads the message (section 5.1) and returns the state.
    fn finish(mut self) -> [W; 8] {
        let bits = self.length.wrapping_mul(8).to_be_bytes();
        self.fill_block(&[0x80]);
        let end = BLOCK.saturating_sub(bits.len());
        // The length has 16 bytes where a block has 128; its upper half is 0 for all that is hashed here.
        let last = BLOCK.saturating_sub(BLOCK / 8);
        if self.used > last {
            while self.used > 0 {
                self.fill_block(&[0]);
            }
        }
        while self.used < end {
            self.fill_block(&[0]);
        }
        self.fill_block(&bits);
        self.state
    }
}

impl<W: Sha2Word<BLOCK>, const BLOCK: usize> Default for Hasher<W, BLOCK> {
    fn default() -> Self {
        Self::new()
    }
}

impl Sha256 {
    /// Returns the digest of all bytes.
    #[must_use]
    pub fn digest(self) -> [u8; 32] {
        let mut digest = [0; 32];
        let words = self.finish();
        for (place, word) in digest.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_be_bytes();
        }
        digest
    }
}

impl Sha512 {
    /// Returns the digest of all bytes.
    #[must_use]
    pub fn digest(self) -> [u8; 64] {
        let mut digest = [0; 64];
        let words = self.finish();
        for (place, word) in digest.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_be_bytes();
        }
        digest
    }
}

/// One round of SHA-256 (section 6.2.2); the next has the names moved on by one.
macro_rules! round {
    ($a:ident $b:ident $c:ident $d:ident $e:ident $f:ident $g:ident $h:ident, $word:expr, $k:expr) => {
        $h = $h
            .wrapping_add($e.rotate_right(6) ^ $e.rotate_right(11) ^ $e.rotate_right(25))
            .wrapping_add($g ^ ($e & ($f ^ $g)))
            .wrapping_add($k)
            .wrapping_add($word);
        $d = $d.wrapping_add($h);
        $h = $h
            .wrapping_add($a.rotate_right(2) ^ $a.rotate_right(13) ^ $a.rotate_right(22))
            .wrapping_add(($a & $b) | ($c & ($a | $b)));
    };
}

impl Sha2Word<64> for u32 {
    const INITIAL_STATE: [Self; 8] = high_halves(&INITIAL_HASH_VALUE);

    fn compress(state: &mut [Self; 8], block: &[u8; 64]) {
        let mut w = [0; 16];
        for (word, bytes) in w.iter_mut().zip(block.as_chunks().0) {
            *word = Self::from_be_bytes(*bytes);
        }
        let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = *state;
        for (turn, k) in ROUND_CONSTANTS_256.as_chunks::<16>().0.iter().enumerate() {
            if turn > 0 {
                extend_message_schedule(&mut w);
            }
            round!(a b c d e f g h, w[0], k[0]);
            round!(h a b c d e f g, w[1], k[1]);
            round!(g h a b c d e f, w[2], k[2]);
            round!(f g h a b c d e, w[3], k[3]);
            round!(e f g h a b c d, w[4], k[4]);
            round!(d e f g h a b c, w[5], k[5]);
            round!(c d e f g h a b, w[6], k[6]);
            round!(b c d e f g h a, w[7], k[7]);
            round!(a b c d e f g h, w[8], k[8]);
            round!(h a b c d e f g, w[9], k[9]);
            round!(g h a b c d e f, w[10], k[10]);
            round!(f g h a b c d e, w[11], k[11]);
            round!(e f g h a b c d, w[12], k[12]);
            round!(d e f g h a b c, w[13], k[13]);
            round!(c d e f g h a b, w[14], k[14]);
            round!(b c d e f g h a, w[15], k[15]);
        }
        for (word, new) in state.iter_mut().zip([a, b, c, d, e, f, g, h]) {
            *word = word.wrapping_add(new);
        }
    }
}

/// The next sixteen words of the message's schedule of SHA-256, in place.
#[inline(always)]
fn extend_message_schedule(w: &mut [u32; 16]) {
    macro_rules! next {
        ($($n:literal)*) => { $({
            let (early, late) = (w[($n + 1) % 16], w[($n + 14) % 16]);
            w[$n] = w[$n]
                .wrapping_add(early.rotate_right(7) ^ early.rotate_right(18) ^ early >> 3)
                .wrapping_add(w[($n + 9) % 16])
                .wrapping_add(late.rotate_right(17) ^ late.rotate_right(19) ^ late >> 10);
        })* };
    }
    next!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
}

impl Sha2Word<128> for u64 {
    const INITIAL_STATE: [Self; 8] = INITIAL_HASH_VALUE;

    fn compress(state: &mut [Self; 8], block: &[u8; 128]) {
        let mut w = [0; 16];
        for (word, bytes) in w.iter_mut().zip(block.as_chunks().0) {
            *word = Self::from_be_bytes(*bytes);
        }
        let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = *state;
        for (n, k) in ROUND_CONSTANTS_512.iter().enumerate() {
            let word = w[n % 16];
            let t1 = h
                .wrapping_add(e.rotate_right(14) ^ e.rotate_right(18) ^ e.rotate_right(41))
                .wrapping_add(g ^ (e & (f ^ g)))
                .wrapping_add(*k)
                .wrapping_add(word);
            let t2 = (a.rotate_right(28) ^ a.rotate_right(34) ^ a.rotate_right(39))
                .wrapping_add((a & b) | (c & (a | b)));
            (h, g, f, e, d, c, b, a) = (g, f, e, d.wrapping_add(t1), c, b, a, t1.wrapping_add(t2));
            // The word of sixteen rounds later.
            let (early, late) = (w[n.wrapping_add(1) % 16], w[n.wrapping_add(14) % 16]);
            w[n % 16] = word
                .wrapping_add(early.rotate_right(1) ^ early.rotate_right(8) ^ early >> 7)
                .wrapping_add(w[n.wrapping_add(9) % 16])
                .wrapping_add(late.rotate_right(19) ^ late.rotate_right(61) ^ late >> 6);
        }
        for (word, new) in state.iter_mut().zip([a, b, c, d, e, f, g, h]) {
            *word = word.wrapping_add(new);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::Digest as _;
    use std::vec::Vec;

    #[test]
    fn every_length_in_any_pieces_has_the_digest_of_the_usual_crate() {
        let message: Vec<u8> =
            (0..700_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        for length in 0..message.len() {
            let message = &message[..length];
            for piece in [1, 17, 63, 64, 65, 128, 200, 700] {
                let (mut short, mut long) = (Sha256::new(), Sha512::new());
                for part in message.chunks(piece) {
                    short.update(part);
                    long.update(part);
                }
                assert_eq!(short.digest()[..], sha2::Sha256::digest(message)[..], "{length}");
                assert_eq!(long.digest()[..], sha2::Sha512::digest(message)[..], "{length}");
            }
        }
    }

    #[test]
    fn a_million_letters_a_have_the_digest_of_the_standard() {
        // NIST's examples of FIPS 180-4.
        let mut hash = Sha256::new();
        (0..1_000).for_each(|_| hash.update(&[b'a'; 1_000]));
        assert_eq!(hash.digest()[..4], [0xcd, 0xc7, 0x6e, 0x5c]);
        let mut hash = Sha512::new();
        (0..1_000).for_each(|_| hash.update(&[b'a'; 1_000]));
        assert_eq!(hash.digest()[..4], [0xe7, 0x18, 0x48, 0x3d]);
    }
}
