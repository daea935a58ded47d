//! The identity of a publisher, in the folder of its spool: an identifier drawn at random, and the number of its
//! last connection.

use std::{
    fs,
    hash::{BuildHasher as _, RandomState},
    io,
    path::Path,
};

const IDENTITY_FILE_NAME: &str = "publisher";

/// Who publishes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublisherIdentity {
    /// Differs from that of every other publisher.
    pub id: String,
    /// The number of its last connection.
    pub bd_seq: u8,
}

/// Reads it; where there is none, or none that can be read, a new one is drawn.
///
/// # Errors
/// The folder cannot be written.
pub(crate) fn read_or_create(folder: &Path) -> io::Result<PublisherIdentity> {
    let text = fs::read_to_string(folder.join(IDENTITY_FILE_NAME)).unwrap_or_default();
    if let Some((id, bd_seq)) = text.trim().split_once(' ')
        && id.len() == 8
        && id.bytes().all(|byte| byte.is_ascii_hexdigit())
        && let Ok(bd_seq) = bd_seq.parse()
    {
        return Ok(PublisherIdentity { id: id.into(), bd_seq });
    }
    let id = format!("{:08x}", RandomState::new().hash_one(IDENTITY_FILE_NAME) as u32);
    let drawn = PublisherIdentity { id, bd_seq: u8::MAX };
    write(folder, &drawn)?;
    Ok(drawn)
}

/// Writes it, as a whole.
///
/// # Errors
/// The folder cannot be written.
pub fn write(folder: &Path, publication: &PublisherIdentity) -> io::Result<()> {
    let PublisherIdentity { id, bd_seq } = publication;
    let new = folder.join("publisher.new");
    fs::write(&new, format!("{id} {bd_seq}\n"))?;
    fs::rename(new, folder.join(IDENTITY_FILE_NAME))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_drawn_once_and_kept_and_a_damaged_one_is_drawn_anew() {
        let folder = tempfile::tempdir().expect("a folder");
        let first = read_or_create(folder.path()).expect("it is drawn");
        assert_eq!(read_or_create(folder.path()).expect("it is kept"), first);
        let later = PublisherIdentity { bd_seq: 7, ..first.clone() };
        write(folder.path(), &later).expect("it is kept");
        assert_eq!(read_or_create(folder.path()).expect("it is kept"), later);
        for damaged in ["", "xyz 7", "0123456 7", "01234567 700"] {
            fs::write(folder.path().join(IDENTITY_FILE_NAME), damaged).expect("the file");
            assert_ne!(
                read_or_create(folder.path()).expect("it is drawn").id,
                first.id,
                "{damaged}"
            );
        }
    }
}
