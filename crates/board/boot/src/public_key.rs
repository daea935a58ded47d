//! Ed25519 signatures (RFC 8032, section 5.1.7), checked without a path that panics.
//!
//! A signature (R, S) of a message M by the key A holds if S is below the order of the group and
//! R = S·B − k·A, with k = SHA-512(R ‖ A ‖ M) and the base point B. Points and scalars are those of
//! `curve25519-dalek`; `ed25519-dalek` on top of it looks points up in tables, with checks of bounds that stay in the
//! image. Here both multiplications go bit by bit, together: 256 doublings and at most 256 additions. Nothing is
//! secret, so the time may depend on the values.

use crate::{hash::Sha512, image_check::VerifyingKey, image_header::SIGNATURE_SIZE};
use curve25519_dalek::{
    Scalar,
    constants::ED25519_BASEPOINT_POINT,
    edwards::{CompressedEdwardsY, EdwardsPoint},
    traits::{Identity as _, IsIdentity as _},
};

/// Bytes of a public key.
pub const PUBLIC_KEY_SIZE: usize = 32;

/// A public key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublicKey {
    bytes: [u8; PUBLIC_KEY_SIZE],
    point: EdwardsPoint,
}

impl PublicKey {
    /// Returns the key of these bytes; `None`: they are none, or a weak one that holds for every message.
    #[must_use]
    pub fn new(bytes: &[u8; PUBLIC_KEY_SIZE]) -> Option<Self> {
        let point = CompressedEdwardsY(*bytes).decompress()?;
        let is_weak = point.mul_by_cofactor().is_identity();
        (!is_weak).then_some(Self { bytes: *bytes, point })
    }
}

impl VerifyingKey for PublicKey {
    #[allow(clippy::arithmetic_side_effects, reason = "points of a group")]
    fn verify(&self, message: &[u8], signature: &[u8; SIGNATURE_SIZE]) -> bool {
        let Some((r, s)) = signature.split_first_chunk::<32>() else { return false };
        let Some(s) = s.first_chunk().and_then(|s| Scalar::from_canonical_bytes(*s).into_option())
        else {
            return false;
        };
        let mut hash = Sha512::new();
        [&r[..], &self.bytes, message].into_iter().for_each(|part| hash.update(part));
        let k = Scalar::from_bytes_mod_order_wide(&hash.digest());
        double_scalar_mul_basepoint(&s, &k, &-self.point).compress().to_bytes() == *r
    }
}

/// Returns s·B + k·A.
#[allow(clippy::arithmetic_side_effects, reason = "points of a group")]
fn double_scalar_mul_basepoint(s: &Scalar, k: &Scalar, a: &EdwardsPoint) -> EdwardsPoint {
    let b = ED25519_BASEPOINT_POINT;
    let both = a + b;
    let mut sum = EdwardsPoint::identity();
    for (s, k) in s.as_bytes().iter().zip(k.as_bytes()).rev() {
        for bit in (0..8).rev() {
            sum = sum + sum;
            match (s >> bit & 1, k >> bit & 1) {
                (0, 0) => {}
                (0, _) => sum += a,
                (_, 0) => sum += b,
                _ => sum += both,
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use ed25519_dalek::{Signer as _, SigningKey};
    use std::vec::Vec;

    fn bytes<const N: usize>(hex: &str) -> [u8; N] {
        core::array::from_fn(|n| u8::from_str_radix(&hex[2 * n..2 * n + 2], 16).expect("hex"))
    }

    #[test]
    fn the_signatures_of_rfc_8032_hold() {
        // Section 7.1: tests 1 to 3.
        for (key, message, signature) in [
            (
                "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
                &[][..],
                "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bac\
                 c61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b",
            ),
            (
                "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
                &[0x72],
                "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da085ac1e43e15996e\
                 458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00",
            ),
            (
                "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
                &[0xaf, 0x82],
                "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290\
                 ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a",
            ),
        ] {
            let (key, signature) = (PublicKey::new(&bytes(key)).unwrap(), bytes(signature));
            assert!(key.verify(message, &signature));
            for bit in 0..8 * SIGNATURE_SIZE {
                let mut other = signature;
                other[bit / 8] ^= 1 << (bit % 8);
                assert!(!key.verify(message, &other), "bit {bit}");
            }
            assert!(!key.verify(b"another message", &signature));
        }
    }

    #[test]
    fn it_agrees_with_the_crate_that_signs_over_any_message_and_bit() {
        for number in 0..60_u8 {
            let signer = SigningKey::from_bytes(&[number.wrapping_mul(41); 32]);
            let key = PublicKey::new(signer.verifying_key().as_bytes()).unwrap();
            let message: Vec<u8> = (0..number).map(|n| n.wrapping_mul(number)).collect();
            let signature = signer.sign(&message);
            assert!(key.verify(&message, &signature.to_bytes()));
            for at in 0..message.len() {
                let mut other = message.clone();
                other[at] ^= 1 << (at % 8);
                let theirs = signer.verifying_key().verify_strict(&other, &signature).is_ok();
                assert_eq!(key.verify(&other, &signature.to_bytes()), theirs);
            }
        }
    }

    #[test]
    fn a_second_form_of_a_signature_and_a_weak_key_are_refused() {
        let signer = SigningKey::from_bytes(&[7; 32]);
        let key = PublicKey::new(signer.verifying_key().as_bytes()).unwrap();
        let mut signature = signer.sign(b"offsets").to_bytes();
        // S plus the order of the group (RFC 8032, section 5.1): the equation holds, the form does not.
        let order: [u8; 32] =
            bytes("edd3f55c1a631258d69cf7a2def9de1400000000000000000000000000000010");
        let mut carry = 0;
        for (place, byte) in signature[32..].iter_mut().zip(order) {
            let sum = u16::from(*place) + u16::from(byte) + carry;
            *place = sum as u8;
            carry = sum >> 8;
        }
        assert_eq!(carry, 0);
        assert!(!key.verify(b"offsets", &signature));
        // The neutral point, and one of order 2.
        for first in [1, 0] {
            let mut weak = [0; 32];
            weak[0] = first;
            assert_eq!(PublicKey::new(&weak), None);
        }
        assert_eq!(PublicKey::new(&[2; 32]), None, "no point");
    }
}
