//! Statements of the manuals, tried on the model. Section numbers are those of RM0090 Rev 21; DS8626 is the data sheet.

mod backup;
mod bench;
mod converters;
mod registers;
mod serial;
