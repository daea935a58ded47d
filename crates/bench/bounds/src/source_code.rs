//! The lines of the project's own source, by which the table names a loop.

use std::{cell::RefCell, collections::BTreeMap, fs, path::PathBuf, rc::Rc};

/// The source of an image.
pub struct SourceCode {
    root: PathBuf,
    files: RefCell<BTreeMap<String, Rc<Vec<String>>>>,
}

impl SourceCode {
    /// Returns the source below a folder. Files that cannot be read have no lines.
    #[must_use]
    pub fn new(root: PathBuf) -> Self {
        Self { root, files: RefCell::default() }
    }

    /// Returns a line of a file, from 1 on.
    #[must_use]
    pub fn line(&self, file: &str, number: u32) -> Option<String> {
        let mut files = self.files.borrow_mut();
        let lines = files.entry(file.to_owned()).or_insert_with(|| {
            // A path of the compiler is its own, or below the root of the project.
            let text =
                fs::read_to_string(file).or_else(|_| fs::read_to_string(self.root.join(file)));
            Rc::new(text.unwrap_or_default().lines().map(str::to_owned).collect())
        });
        lines.get(usize::try_from(number).ok()?.checked_sub(1)?).cloned()
    }
}
