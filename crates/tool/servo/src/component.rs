//! The component in C, as text: `trueup linuxcnc component` compiles it on the computer on which LinuxCNC runs.

/// Name of the static library.
pub const LIBRARY_FILE_NAME: &str = "libtrueup_servo.a";
/// Source of the component.
pub const COMPONENT_C_SOURCE: &str = include_str!("../hal/trueup_node.c");
/// The C interface of the library.
pub const COMPONENT_C_HEADER: &str = include_str!("../hal/trueup_servo.h");
