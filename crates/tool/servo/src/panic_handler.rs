//! The panic handler, which a static library without `std` needs. Nothing leads to it, which a test shows on the library.
#![allow(unsafe_code, reason = "C's way to end a process")]

unsafe extern "C" {
    safe fn abort() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    abort()
}
