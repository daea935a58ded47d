//! RAM that a reset does not clear: `.uninit` is neither loaded nor zeroed.

use core::{mem::MaybeUninit, ptr::addr_of_mut};

use trueup_store::retained_state::{RETAINED_COPY_SIZE, RetainedCopies};

/// Its bytes are whatever they were; any are valid ones, and their CRC says which mean something.
#[unsafe(link_section = ".uninit.RETAINED")]
#[allow(unsafe_code, reason = "the place of a static")]
static mut RETAINED_COPIES: MaybeUninit<RetainedCopies> = MaybeUninit::uninit();

/// Returns the copies, to the first caller.
#[allow(unsafe_code, reason = "uninitialised memory")]
pub fn take_retained_copies() -> &'static mut RetainedCopies {
    let once: &'static mut () = cortex_m::singleton!(: () = ()).expect("the board starts once");
    let () = *once;
    let place = addr_of_mut!(RETAINED_COPIES).cast::<u8>();
    for at in 0..2 * RETAINED_COPY_SIZE {
        // SAFETY: within the static, which no other code has. Volatile, so that the bytes count as
        // written: what stood there is read, as hardware has it, and put back.
        unsafe { place.add(at).write_volatile(place.add(at).read_volatile()) };
    }
    // SAFETY: every byte was just written, the singleton above makes this the only reference, and
    // an array of bytes has no invalid value.
    unsafe { &mut *place.cast::<RetainedCopies>() }
}
