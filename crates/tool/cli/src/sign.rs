//! `trueup sign`: makes a key, signs files, and checks signatures.

use std::{
    fs::OpenOptions,
    io::Write as _,
    path::{Path, PathBuf},
};

use anyhow::Result;
use clap::Args;
use trueup_signature::{PrivateKey, PublicKey};

use crate::{
    CommandOutcome, UserError, input_files,
    output::{self, FileTransaction},
    report,
};

/// A file that is handed out is no larger than this.
const MAX_SIGNED_FILE_BYTES: u64 = 1 << 30;
/// A key in PEM has some hundred.
const MAX_KEY_OR_SIGNATURE_BYTES: u64 = 10_000;

/// Signs files (Ed25519), so that the receiver can check from whom they are: FILE.sig next to each.
///
/// openssl checks the same signatures: openssl pkeyutl -verify -pubin -inkey KEY.pub.pem -rawin -in FILE -sigfile FILE.sig
///
/// Exit 3: with --check, a signature does not hold or is missing.
#[derive(Args)]
pub struct SignArgs {
    /// The files.
    #[arg(value_name = "FILE", required_unless_present = "new")]
    files: Vec<PathBuf>,
    /// Signs them with this private key.
    #[arg(long, value_name = "KEY.pem")]
    key: Option<PathBuf>,
    /// Checks their signatures with this public key.
    #[arg(long, value_name = "KEY.pub.pem", conflicts_with = "key")]
    check: Option<PathBuf>,
    /// Makes a key pair: the private key here, readable by you alone, and the public one in KEY.pub.pem next to it.
    #[arg(long, value_name = "KEY.pem", conflicts_with_all = ["key", "check", "files"])]
    new: Option<PathBuf>,
}

/// Makes a key, signs or checks.
pub fn run(args: &SignArgs) -> Result<CommandOutcome> {
    match (&args.new, &args.key, &args.check) {
        (Some(path), ..) => generate_key_pair(path),
        (None, Some(key), _) => sign_files(key, &args.files),
        (None, None, Some(key)) => verify_signatures(key, &args.files),
        (None, None, None) => {
            let rule = "--key KEY.pem signs the files, --check KEY.pub.pem checks their signatures";
            Err(UserError(rule.into()).into())
        }
    }
}

fn generate_key_pair(path: &Path) -> Result<CommandOutcome> {
    let key = PrivateKey::generate()?;
    let (private, public) = (key.to_pem()?, key.public_key().to_pem()?);
    let adjacent = public_key_path(path);
    if adjacent.exists() {
        let rule = "there is a public key already; a new pair needs another name";
        return Err(UserError(format!("{}: {rule}", adjacent.display())).into());
    }
    let mut options = OpenOptions::new();
    // A key that is lost cannot be had again, so nothing is ever written over.
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options
        .open(path)
        .map_err(|error| UserError(format!("{}: cannot be made: {error}", path.display())))?;
    file.write_all(private.as_bytes()).and_then(|()| file.sync_all())?;
    output::write_atomically(&adjacent, &[path], |out| out.write_all(public.as_bytes()))?;
    report::print_warning(format_args!(
        "{}: anyone who has this file can sign in your name; keep a copy without access to a network",
        path.display()
    ));
    output::print(adjacent.display())?;
    Ok(CommandOutcome::Done)
}

/// Returns `KEY.pub.pem` for `KEY.pem`.
fn public_key_path(private: &Path) -> PathBuf {
    private.with_extension("pub.pem")
}

/// Returns `FILE.sig` for `FILE`.
fn signature_path(file: &Path) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(".sig");
    name.into()
}

fn sign_files(key: &Path, names: &[PathBuf]) -> Result<CommandOutcome> {
    let pem = input_files::read_text(key, MAX_KEY_OR_SIGNATURE_BYTES)?;
    let private = PrivateKey::from_pem(&pem).map_err(|fault| key_error(key, fault))?;
    let inputs: Vec<&Path> = names.iter().map(PathBuf::as_path).chain([key]).collect();
    let mut set = FileTransaction::new(&inputs);
    for file in names {
        let signature = private.sign(&input_files::read_bytes(file, MAX_SIGNED_FILE_BYTES)?);
        set.add(&signature_path(file), |out| out.write_all(&signature))?;
    }
    set.commit()?;
    for file in names {
        output::print(signature_path(file).display())?;
    }
    Ok(CommandOutcome::Done)
}

fn verify_signatures(key: &Path, names: &[PathBuf]) -> Result<CommandOutcome> {
    let pem = input_files::read_text(key, MAX_KEY_OR_SIGNATURE_BYTES)?;
    let public = PublicKey::from_pem(&pem).map_err(|fault| key_error(key, fault))?;
    let mut outcome = CommandOutcome::Done;
    for file in names {
        let path = signature_path(file);
        let signature_state = if path.is_file() {
            let message = input_files::read_bytes(file, MAX_SIGNED_FILE_BYTES)?;
            let signature = input_files::read_bytes(&path, MAX_KEY_OR_SIGNATURE_BYTES)?;
            public.verify(&message, &signature).map_err(|fault| fault.to_string())
        } else {
            Err("is missing".to_owned())
        };
        match signature_state {
            Ok(()) => output::print(format_args!("{}: signed by this key", file.display()))?,
            Err(why) => {
                report::print_warning(format_args!("{}: the signature {why}", file.display()));
                outcome = CommandOutcome::NotMet;
            }
        }
    }
    Ok(outcome)
}

fn key_error(key: &Path, fault: trueup_signature::SignatureError) -> anyhow::Error {
    UserError(format!("{}: {fault}; trueup sign --new KEY.pem makes a pair", key.display())).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_key_and_signature() {
        assert_eq!(public_key_path(Path::new("a/shop.pem")), Path::new("a/shop.pub.pem"));
        assert_eq!(signature_path(Path::new("a/x.tar.gz")), Path::new("a/x.tar.gz.sig"));
    }
}
