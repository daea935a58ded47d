//! LinuxCNC's hardware abstraction layer, as far as a component needs it. The only `unsafe` file.
//!
//! The library is opened at run time, so that neither its header nor LinuxCNC is needed to build,
//! and the host tool runs where there is none. All components and LinuxCNC's realtime part share one
//! piece of memory; a pin is a pointer in it that LinuxCNC turns to whatever the pin is connected
//! to, so it is followed again at each access. Names, types and directions are those of `hal.h`.
#![allow(unsafe_code)]

use std::{
    cell::{RefCell, UnsafeCell},
    ffi::{CStr, CString, c_char, c_int, c_long, c_void},
    fs,
    marker::PhantomData,
    ptr,
};

use libloading::Library;

/// The library of LinuxCNC 2.8 and 2.9.
const HAL_LIBRARY: &str = "liblinuxcnchal.so.0";
/// `HAL_IN` and `HAL_OUT`.
const HAL_IN: c_int = 16;
const HAL_OUT: c_int = 32;
/// The longest name of a pin in bytes: `HAL_NAME_LEN` of LinuxCNC's `hal.h`.
const MAX_PIN_NAME_BYTES: usize = 47;

type NewPinFn = unsafe extern "C" fn(*const c_char, c_int, *mut *mut c_void, c_int) -> c_int;
type PinByNameFn =
    unsafe extern "C" fn(*const c_char, *mut c_int, *mut *mut c_void, *mut bool) -> c_int;

/// A type that a pin can have.
pub(crate) trait PinType: sealed::Sealed + Copy {
    /// The function that makes such a pin.
    #[doc(hidden)]
    const NEW_PIN_SYMBOL: &'static [u8];
    /// Its number in `hal_type_t`.
    #[doc(hidden)]
    const HAL_TYPE: c_int;
    /// Content of the shared memory.
    #[doc(hidden)]
    type Raw: Copy;
    #[doc(hidden)]
    fn from_raw(raw: Self::Raw) -> Self;
    #[doc(hidden)]
    fn to_raw(self) -> Self::Raw;
}

mod sealed {
    pub trait Sealed {}
}

macro_rules! pin_type {
    ($type:ty, $raw:ty, $kind:literal, $make:literal, $from:expr, $to:expr) => {
        impl sealed::Sealed for $type {}
        impl PinType for $type {
            const NEW_PIN_SYMBOL: &'static [u8] = $make;
            const HAL_TYPE: c_int = $kind;
            type Raw = $raw;
            fn from_raw(raw: $raw) -> Self {
                $from(raw)
            }
            fn to_raw(self) -> $raw {
                $to(self)
            }
        }
    };
}

// A byte that another program wrote need not be 0 or 1, which a `bool` must be.
pin_type!(bool, u8, 1, b"hal_pin_bit_new\0", |raw| raw != 0, u8::from);
pin_type!(f64, f64, 2, b"hal_pin_float_new\0", |raw| raw, |value| value);
pin_type!(i32, i32, 3, b"hal_pin_s32_new\0", |raw| raw, |value| value);
pin_type!(u32, u32, 4, b"hal_pin_u32_new\0", |raw| raw, |value| value);

/// A pin of this component.
#[derive(Debug)]
pub(crate) struct Pin<'hal, T: PinType> {
    /// The cell in the shared memory where LinuxCNC keeps where the value is.
    cell: *const *mut T::Raw,
    hal: PhantomData<&'hal HalComponent>,
}

impl<T: PinType> Pin<'_, T> {
    /// Returns what the pin, or the signal that it is connected to, says now.
    #[must_use]
    pub fn get(&self) -> T {
        // SAFETY: `cell` was made by `Hal::create_pin`: it lies in the HAL's memory, or is kept by `Hal`,
        // and holds a pointer into the HAL's memory, which stays attached for the lifetime of `Hal`
        // and which LinuxCNC keeps valid and aligned for the type. Others write it at any time, hence volatile; a value of
        // at most 8 aligned bytes is read in one piece on the processors that LinuxCNC runs on.
        T::from_raw(unsafe { ptr::read_volatile(ptr::read_volatile(self.cell).cast_const()) })
    }

    /// Lets the pin, and the signal that it is connected to, say this.
    pub fn set(&self, value: T) {
        // SAFETY: as in `get`; this component is the only writer of its own pins, and every
        // reader expects them to change at any time.
        unsafe { ptr::write_volatile(ptr::read_volatile(self.cell), value.to_raw()) }
    }
}

/// A component in the HAL.
#[derive(Debug)]
pub struct HalComponent {
    library: Library,
    id: c_int,
    /// The pins are those of a component whose process was killed.
    adopts: bool,
    adopted: RefCell<Vec<AdoptedPin>>,
}

/// A pin of a component whose process was killed.
#[derive(Debug)]
struct AdoptedPin {
    name: CString,
    kind: c_int,
    /// Where its value is; on the heap, because a [`Pin`] points to it.
    cell: Box<UnsafeCell<*mut c_void>>,
}

/// A pin, as the HAL has it.
struct PinInfo {
    kind: c_int,
    data: *mut c_void,
    is_connected: bool,
}

impl HalComponent {
    /// Registers a component.
    ///
    /// Where one of this name is left over from a process that was killed, which `pid_pin` shows,
    /// its pins are adopted, with all their connections: a restarted component need not be wired
    /// again, and at no moment is a pin missing.
    ///
    /// # Errors
    /// LinuxCNC's library is not here or is another one; a component of this name is alive; a name
    /// that the HAL cannot take.
    pub fn new(name: &str, pid_pin: &str) -> Result<Self, HalError> {
        // SAFETY: the library of LinuxCNC has no initialiser that could do harm, and stays loaded
        // as long as anything of it is used, because `Hal` owns it.
        let library = unsafe { Library::new(HAL_LIBRARY) }
            .map_err(|error| HalError::NoLibrary(error.to_string()))?;
        let mut hal = Self { library, id: 0, adopts: false, adopted: RefCell::default() };
        if let Ok(id) = hal.init(name) {
            hal.id = id;
            return Ok(hal);
        }
        hal.id = hal.init(&format!("{name}-{}", std::process::id()))?;
        hal.adopts = true;
        match hal.read_foreign_pin::<u32>(pid_pin) {
            Some(pid) if !is_process_alive(pid) => Ok(hal),
            pid => Err(HalError::NameInUse { name: name.into(), pid }),
        }
    }

    /// Returns whether the pins are those of a component whose process was killed.
    #[must_use]
    pub(crate) fn has_adopted_pins(&self) -> bool {
        self.adopts
    }

    /// Looks where the adopted pins are connected to now. LinuxCNC reports that to the dead process
    /// only, so this has to be called from time to time.
    pub(crate) fn refresh_adopted_pins(&self) {
        for pin in &*self.adopted.borrow() {
            if let Some(data) = self.find_pin_data_pointer(&pin.name, pin.kind) {
                // SAFETY: the cell lives as long as `Hal`; no `Pin` reads it meanwhile, because
                // neither can leave its thread.
                unsafe { ptr::write_volatile(pin.cell.get(), data) }
            }
        }
    }

    /// Returns a pin that others write.
    ///
    /// # Errors
    /// The HAL refuses: the name is taken or too long, or its memory is full.
    pub(crate) fn create_input_pin<T: PinType>(&self, name: &str) -> Result<Pin<'_, T>, HalError> {
        self.create_pin(name, HAL_IN)
    }

    /// Returns a pin that this component writes.
    ///
    /// # Errors
    /// As [`Self::create_input_pin`].
    pub(crate) fn create_output_pin<T: PinType>(&self, name: &str) -> Result<Pin<'_, T>, HalError> {
        self.create_pin(name, HAL_OUT)
    }

    /// Returns what anybody's pin says; `None` if there is none of this name and type.
    #[must_use]
    pub(crate) fn read_foreign_pin<T: PinType>(&self, name: &str) -> Option<T> {
        let data = self.find_pin_data_pointer(&to_c_string(name).ok()?, T::HAL_TYPE)?;
        // SAFETY: the HAL says that a value of this type lies there, in its memory, which is
        // attached; volatile, because others write it.
        Some(T::from_raw(unsafe { ptr::read_volatile(data.cast::<T::Raw>()) }))
    }

    /// Returns whether anybody's pin is connected to a signal; `None` if there is none of this name.
    #[must_use]
    pub(crate) fn is_pin_connected(&self, name: &str) -> Option<bool> {
        self.find_pin(&to_c_string(name).ok()?).map(|found| found.is_connected)
    }

    /// Says that all pins are there: `loadusr -W` waits for it.
    ///
    /// # Errors
    /// The HAL refuses.
    pub(crate) fn set_ready(&self) -> Result<(), HalError> {
        type ReadyFn = unsafe extern "C" fn(c_int) -> c_int;
        let ready = self.load_function::<ReadyFn>("hal_ready", b"hal_ready\0")?;
        // SAFETY: the signature is that of `hal.h`, and the number is that of this component.
        check_return_code("hal_ready", unsafe { ready(self.id) }).map(drop)
    }

    fn create_pin<T: PinType>(&self, name: &str, direction: c_int) -> Result<Pin<'_, T>, HalError> {
        type MallocFn = unsafe extern "C" fn(c_long) -> *mut c_void;
        let text = to_c_string(name)?;
        if self.adopts
            && let Some(data) = self.find_pin_data_pointer(&text, T::HAL_TYPE)
        {
            let cell = Box::new(UnsafeCell::new(data));
            let place = cell.get();
            self.adopted.borrow_mut().push(AdoptedPin { name: text, kind: T::HAL_TYPE, cell });
            return Ok(Pin { cell: place.cast_const().cast(), hal: PhantomData });
        }
        let malloc = self.load_function::<MallocFn>("hal_malloc", b"hal_malloc\0")?;
        let make = self.load_function::<NewPinFn>("hal_pin_…_new", T::NEW_PIN_SYMBOL)?;
        // SAFETY: the signature is that of `hal.h`; the size is that of a pointer.
        let cell = unsafe { malloc(size_of::<*mut c_void>() as c_long) }.cast::<*mut c_void>();
        if cell.is_null() {
            return Err(HalError::Call { what: "hal_malloc", code: 0 });
        }
        // SAFETY: the signature is that of `hal.h`; the name ends with a zero byte and is copied;
        // the cell is from `hal_malloc`, as it must be, and large enough.
        let code = unsafe { make(text.as_ptr(), direction, cell, self.id) };
        check_return_code("hal_pin_new", code)?;
        Ok(Pin { cell: cell.cast_const().cast(), hal: PhantomData })
    }

    fn init(&self, name: &str) -> Result<c_int, HalError> {
        type InitFn = unsafe extern "C" fn(*const c_char) -> c_int;
        let init = self.load_function::<InitFn>("hal_init", b"hal_init\0")?;
        let text = to_c_string(name)?;
        // SAFETY: the signature is that of `hal.h`; the name ends with a zero byte and is copied.
        check_return_code("hal_init", unsafe { init(text.as_ptr()) })
    }

    fn exit(&self, id: c_int) -> Result<(), HalError> {
        type ExitFn = unsafe extern "C" fn(c_int) -> c_int;
        let exit = self.load_function::<ExitFn>("hal_exit", b"hal_exit\0")?;
        // SAFETY: the signature is that of `hal.h`. No pin of the component is used afterwards:
        // pins borrow from `Hal`.
        check_return_code("hal_exit", unsafe { exit(id) }).map(drop)
    }

    /// Where the value of anybody's pin of this kind is.
    fn find_pin_data_pointer(&self, pin: &CStr, kind: c_int) -> Option<*mut c_void> {
        self.find_pin(pin)
            .filter(|found| found.kind == kind && !found.data.is_null())
            .map(|found| found.data)
    }

    fn find_pin(&self, pin: &CStr) -> Option<PinInfo> {
        let by_name = self
            .load_function::<PinByNameFn>(
                "hal_get_pin_value_by_name",
                b"hal_get_pin_value_by_name\0",
            )
            .ok()?;
        let mut found = PinInfo { kind: 0, data: ptr::null_mut(), is_connected: false };
        // SAFETY: the signature is that of `hal.h`; the three places are valid for writing.
        let code = unsafe {
            by_name(pin.as_ptr(), &mut found.kind, &mut found.data, &mut found.is_connected)
        };
        (code == 0).then_some(found)
    }

    /// Returns a function of the library; `F` is its type in `hal.h`.
    fn load_function<F: Copy>(&self, name: &'static str, symbol: &[u8]) -> Result<F, HalError> {
        // SAFETY: every caller states the type that `hal.h` declares for the symbol, and calls it
        // while `self.library` is loaded.
        let found = unsafe { self.library.get::<F>(symbol) };
        found.map(|function| *function).map_err(|_| HalError::NoFunction(name))
    }
}

impl Drop for HalComponent {
    fn drop(&mut self) {
        if self.id > 0 {
            // At the end of the process an error cannot be reported.
            self.exit(self.id).ok();
        }
    }
}

fn to_c_string(name: &str) -> Result<CString, HalError> {
    let bad = || HalError::Name(name.into());
    if name.len() > MAX_PIN_NAME_BYTES {
        return Err(bad());
    }
    CString::new(name).map_err(|_| bad())
}

fn check_return_code(what: &'static str, code: c_int) -> Result<c_int, HalError> {
    if code < 0 { Err(HalError::Call { what, code }) } else { Ok(code) }
}

/// Returns whether a process runs; one that has ended and is not waited for does not.
#[must_use]
pub fn is_process_alive(pid: u32) -> bool {
    let Ok(stat) = fs::read_to_string(format!("/proc/{pid}/stat")) else { return false };
    // "pid (name) state …"; the name may contain anything.
    let state = stat.rsplit(')').next().unwrap_or_default().trim_start();
    !state.starts_with(['Z', 'X'])
}

/// Why the HAL cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HalError {
    /// LinuxCNC's library cannot be opened.
    #[error("{HAL_LIBRARY} cannot be opened; is LinuxCNC 2.8 or 2.9 installed? {0}")]
    NoLibrary(String),
    /// It lacks a function: another version of LinuxCNC.
    #[error("{HAL_LIBRARY} has no {0}: it is not that of LinuxCNC 2.8 or 2.9")]
    NoFunction(&'static str),
    /// A call is refused, with the code that it gave.
    #[error("the HAL refuses {what} (code {code})")]
    Call {
        /// The HAL's function that refused.
        what: &'static str,
        /// A negative number of `errno.h`.
        code: c_int,
    },
    /// A component of this name is alive.
    #[error("{}", name_in_use_message(.name, *.pid))]
    NameInUse {
        /// The component's name.
        name: String,
        /// The number of its process, where that is known.
        pid: Option<u32>,
    },
    /// The HAL takes no such name.
    #[error("\"{0}\" is not a name for the HAL: at most {MAX_PIN_NAME_BYTES} characters")]
    Name(String),
}

fn name_in_use_message(name: &str, pid: Option<u32>) -> String {
    match pid {
        Some(pid) => format!("a HAL component called {name} is running already, as process {pid}"),
        None => format!("there is another HAL component called {name}"),
    }
}
