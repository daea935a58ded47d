//! What the manuals say, tried on the model. Section numbers are RM0090's; DS8626 is the data sheet.

mod backup;
mod bench;
mod converters;
mod registers;
mod serial;
