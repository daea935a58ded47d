//! Signatures of released files, so that the recipient of a file can check from whom it is.
//!
//! A signature is Ed25519 (RFC 8032) over the whole file, 64 bytes. Keys are PEM: the private one PKCS #8 (RFC 8410),
//! the public one SubjectPublicKeyInfo. `openssl pkeyutl` reads both, and makes and checks the same signatures:
//!
//! ```text
//! openssl pkeyutl -verify -pubin -inkey KEY.pub.pem -rawin -in FILE -sigfile FILE.sig
//! ```

use ed25519_dalek::{
    Signature, Signer as _, SigningKey, VerifyingKey,
    pkcs8::{
        DecodePrivateKey as _, DecodePublicKey as _, EncodePrivateKey as _, EncodePublicKey as _,
        KeypairBytes, spki::der::pem::LineEnding,
    },
};

/// Bytes of a signature.
pub(crate) const SIGNATURE_BYTES: usize = 64;

/// Errors of a key or a signature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SignatureError {
    /// The text is no private key of Ed25519 in PEM.
    #[error("is no private key of Ed25519 in PEM")]
    NoPrivateKey,
    /// The text is no public key of Ed25519 in PEM.
    #[error("is no public key of Ed25519 in PEM")]
    NoPublicKey,
    /// The signature does not have `SIGNATURE_BYTES` bytes.
    #[error("is no signature: it does not have 64 bytes")]
    WrongLength,
    /// The message was changed, or was signed with another key.
    #[error("does not hold: the file was changed, or was signed with another key")]
    DoesNotHold,
    /// The system gives no random numbers.
    #[error("the system gives no random numbers")]
    NoRandomNumbers,
}

/// A private key. Its bytes are overwritten when it is dropped.
pub struct PrivateKey(SigningKey);

impl PrivateKey {
    /// Returns a new key of the system's random numbers.
    ///
    /// # Errors
    /// [`SignatureError::NoRandomNumbers`].
    pub fn generate() -> Result<Self, SignatureError> {
        let mut seed = [0; 32];
        getrandom::fill(&mut seed).map_err(|_| SignatureError::NoRandomNumbers)?;
        Ok(Self(SigningKey::from_bytes(&seed)))
    }

    /// Reads a key in PEM (PKCS #8).
    ///
    /// # Errors
    /// [`SignatureError::NoPrivateKey`].
    pub fn from_pem(pem: &str) -> Result<Self, SignatureError> {
        SigningKey::from_pkcs8_pem(pem).map(Self).map_err(|_| SignatureError::NoPrivateKey)
    }

    /// Returns the key in PEM (PKCS #8): anyone who has it can sign in its owner's name.
    ///
    /// # Errors
    /// [`SignatureError::NoPrivateKey`]: the encoder refuses it, which no valid key causes.
    pub fn to_pem(&self) -> Result<String, SignatureError> {
        // With the public key in it the file is of PKCS #8's second version, which openssl 3.0 does not read.
        let pair = KeypairBytes { secret_key: self.0.to_bytes(), public_key: None };
        let pem = pair.to_pkcs8_pem(LineEnding::LF).map_err(|_| SignatureError::NoPrivateKey)?;
        Ok(pem.as_str().to_owned())
    }

    /// Returns the public key.
    #[must_use]
    pub fn public_key(&self) -> PublicKey {
        PublicKey(self.0.verifying_key())
    }

    /// Returns the signature of a message.
    #[must_use]
    pub fn sign(&self, message: &[u8]) -> [u8; SIGNATURE_BYTES] {
        self.0.sign(message).to_bytes()
    }
}

/// A public key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublicKey(VerifyingKey);

impl PublicKey {
    /// Reads a key in PEM (SubjectPublicKeyInfo).
    ///
    /// # Errors
    /// [`SignatureError::NoPublicKey`].
    pub fn from_pem(pem: &str) -> Result<Self, SignatureError> {
        VerifyingKey::from_public_key_pem(pem).map(Self).map_err(|_| SignatureError::NoPublicKey)
    }

    /// Returns the key in PEM (SubjectPublicKeyInfo).
    ///
    /// # Errors
    /// [`SignatureError::NoPublicKey`]: the encoder refuses it, which no valid key causes.
    pub fn to_pem(&self) -> Result<String, SignatureError> {
        self.0.to_public_key_pem(LineEnding::LF).map_err(|_| SignatureError::NoPublicKey)
    }

    /// Returns the 32 bytes of the key (RFC 8032, section 5.1.5), as a boot program has them.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; 32] {
        self.0.to_bytes()
    }

    /// Checks a signature, by the strict rule: weak keys and signatures of a second form are refused.
    ///
    /// # Errors
    /// [`SignatureError::WrongLength`] or [`SignatureError::DoesNotHold`].
    pub fn verify(&self, message: &[u8], signature: &[u8]) -> Result<(), SignatureError> {
        let bytes = signature.try_into().map_err(|_| SignatureError::WrongLength)?;
        let signature = Signature::from_bytes(bytes);
        self.0.verify_strict(message, &signature).map_err(|_| SignatureError::DoesNotHold)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes<const N: usize>(hex: &str) -> [u8; N] {
        std::array::from_fn(|n| u8::from_str_radix(&hex[2 * n..2 * n + 2], 16).expect("hex"))
    }

    /// The second test of RFC 8032, section 7.1: one byte, 72.
    #[test]
    fn the_signature_of_rfc_8032() {
        let seed = bytes("4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb");
        let key = PrivateKey(SigningKey::from_bytes(&seed));
        let requested: [u8; 64] = bytes(
            "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da\
             085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00",
        );
        assert_eq!(key.sign(&[0x72]), requested);
        assert_eq!(key.public_key().verify(&[0x72], &requested), Ok(()));
    }

    #[test]
    fn any_flipped_bit_of_message_or_signature_is_refused() {
        let key = PrivateKey::generate().expect("a system with random numbers");
        let (message, public) = (*b"offsets", key.public_key());
        let signature = key.sign(&message);
        for bit in 0..8 * message.len() {
            let mut other = message;
            other[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(
                public.verify(&other, &signature),
                Err(SignatureError::DoesNotHold),
                "{bit}"
            );
        }
        for bit in 0..8 * SIGNATURE_BYTES {
            let mut other = signature;
            other[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(public.verify(&message, &other), Err(SignatureError::DoesNotHold), "{bit}");
        }
        assert_eq!(public.verify(&message, &signature[..63]), Err(SignatureError::WrongLength));
        let stranger = PrivateKey::generate().expect("a system with random numbers").public_key();
        assert_eq!(stranger.verify(&message, &signature), Err(SignatureError::DoesNotHold));
    }

    #[test]
    fn keys_are_read_back_and_other_texts_are_refused() {
        let key = PrivateKey::generate().expect("a system with random numbers");
        let (private, public) =
            (key.to_pem().expect("valid"), key.public_key().to_pem().expect("valid"));
        assert_eq!(PrivateKey::from_pem(&private).expect("its own").sign(b"a"), key.sign(b"a"));
        assert_eq!(PublicKey::from_pem(&public), Ok(key.public_key()));
        assert_eq!(PublicKey::from_pem(&private), Err(SignatureError::NoPublicKey));
        assert!(matches!(PrivateKey::from_pem(&public), Err(SignatureError::NoPrivateKey)));
        assert!(matches!(PrivateKey::from_pem(""), Err(SignatureError::NoPrivateKey)));
    }
}
