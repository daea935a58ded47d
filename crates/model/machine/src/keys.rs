//! What a key of the machine file is: how one is declared, read strictly, and written.
//!
//! Nothing here knows a section, a cause or a machine; the sections and the causes are written in these terms.
//!
//! | file | is |
//! |---|---|
//! | `key` | a key: its name, form, unit, default and meaning |
//! | `range` | the range that its numbers should have |
//! | `table` | sections whose keys are the fields of a struct, each declared once |
//! | `term` | the keys of `[[term]]`, which causes share |
//! | `reader` | one table of a TOML file, read strictly |
//! | `section` | a section that is to be written |

pub(crate) mod key;
pub(crate) mod plausible_range;
pub(crate) mod reader;
pub(crate) mod section;
pub(crate) mod table;
pub(crate) mod term;
