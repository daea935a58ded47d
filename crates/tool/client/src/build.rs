//! Of which source a bridge's firmware was built, and a tool that speaks to it: the two have to agree.

use std::fmt::{self, Display};

use anyhow::Result;

use crate::{
    sdo_object::{self, COMMIT, LEGACY_COMMIT, SOFTWARE_VERSION},
    session::Session,
};

/// A version and, where it is known, the commit that it is of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildVersion {
    version: String,
    /// The first 32 bits of its hash.
    commit: Option<u32>,
}

impl BuildVersion {
    /// Returns the build of a tool, as its build script gives it: `commit` in 8 hexadecimal digits; otherwise unknown.
    #[must_use]
    pub fn new(version: &str, commit: &str) -> Self {
        Self { version: version.into(), commit: u32::from_str_radix(commit, 16).ok() }
    }

    /// Returns what the bridge says of itself. A firmware up to 0.2.0 has its commit in another place; an older one says none.
    ///
    /// # Errors
    /// It does not say its version, or the line is broken.
    pub fn read(session: &mut Session) -> Result<Self> {
        let version = sdo_object::read_text(session, SOFTWARE_VERSION)?;
        let commit = sdo_object::read_number(session, COMMIT)
            .or_else(|_| sdo_object::read_number(session, LEGACY_COMMIT))
            .ok()
            .filter(|commit| *commit != 0);
        Ok(Self { version, commit })
    }

    /// Returns the same version, of the commit that a bridge has answered.
    #[must_use]
    pub fn with_commit(&self, answer: &[u8]) -> Self {
        let commit = answer.first_chunk().copied().map(u32::from_le_bytes);
        Self { version: self.version.clone(), commit: commit.filter(|commit| *commit != 0) }
    }

    /// Returns what to say where the bridge's firmware is of another source than this tool; `None` where it is of the
    /// same, as far as both know theirs.
    ///
    /// ```
    /// use trueup_client::build::BuildVersion;
    /// let tool = BuildVersion::new("0.2.0", "1a2b3c4d");
    /// assert_eq!(tool.describe_difference(&BuildVersion::new("0.2.0", "1a2b3c4d")), None);
    /// assert_eq!(tool.describe_difference(&BuildVersion::new("0.2.0", "unknown")), None);
    /// let message = tool.describe_difference(&BuildVersion::new("0.2.0", "00000007")).unwrap();
    /// assert!(message.starts_with("the bridge's firmware is 0.2.0 (00000007), this tool 0.2.0 (1a2b3c4d)"));
    /// assert!(tool.describe_difference(&BuildVersion::new("0.1.0", "unknown")).is_some());
    /// ```
    #[must_use]
    pub fn describe_difference(&self, bridge: &Self) -> Option<String> {
        let is_other_commit =
            self.commit.zip(bridge.commit).is_some_and(|(tool, bridge)| tool != bridge);
        (self.version != bridge.version || is_other_commit).then(|| {
            format!(
                "the bridge's firmware is {bridge}, this tool {self}: flash the image of this tool \
                 (`trueup firmware`), or use the tool of that one"
            )
        })
    }
}

impl Display for BuildVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.commit {
            Some(commit) => write!(f, "{} ({commit:08x})", self.version),
            None => write!(f, "{}", self.version),
        }
    }
}
