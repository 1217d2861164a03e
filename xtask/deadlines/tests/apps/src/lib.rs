//! The little of a microcontroller that the applications need: six interrupts that software pends, and a
//! register that no compiler knows.

#![no_std]

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, AtomicPtr, AtomicU8, AtomicU32, Ordering};

// Start-up and vector table.
use cortex_m_rt as _;

/// Bits of an interrupt's priority.
#[cfg(feature = "v6")]
pub const NVIC_PRIO_BITS: u8 = 2;
/// Bits of an interrupt's priority.
#[cfg(not(feature = "v6"))]
pub const NVIC_PRIO_BITS: u8 = 4;

/// Clock of the core in Hz.
#[cfg(not(feature = "v6"))]
pub const CORE_HZ: u32 = 16_000_000;
/// Clock of the core in Hz.
#[cfg(feature = "v6")]
pub const CORE_HZ: u32 = 48_000_000;

/// The interrupts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
#[repr(u16)]
pub enum Interrupt {
    /// A timer.
    TIM_A = 1,
    /// Another one.
    TIM_B = 2,
    /// A serial port.
    UART = 3,
    /// A converter.
    ADC = 4,
    /// Of no peripheral that is used.
    SOFT_A = 5,
    /// The same.
    SOFT_B = 6,
}

/// As RTIC spells it.
pub use Interrupt as interrupt;

// SAFETY: these are their places in the part's vector table.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

unsafe extern "C" {
    fn TIM_A();
    fn TIM_B();
    fn UART();
    fn ADC();
    fn SOFT_A();
    fn SOFT_B();
}

/// An entry of the vector table.
#[derive(Clone, Copy)]
pub union Vector {
    handler: unsafe extern "C" fn(),
    reserved: usize,
}

/// The vectors of the part's interrupts.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
pub static __INTERRUPTS: [Vector; 7] = [
    Vector { reserved: 0 },
    Vector { handler: TIM_A },
    Vector { handler: TIM_B },
    Vector { handler: UART },
    Vector { handler: ADC },
    Vector { handler: SOFT_A },
    Vector { handler: SOFT_B },
];

static REGISTER: AtomicU32 = AtomicU32::new(12_345);

/// A number that is different each time.
pub fn input() -> u32 {
    let value = REGISTER.load(Ordering::Relaxed).wrapping_mul(1_664_525);
    REGISTER.store(value, Ordering::Relaxed);
    value
}

/// Puts a result where the compiler cannot remove it.
pub fn output(value: u32) {
    REGISTER.store(value, Ordering::Relaxed);
}

/// A level that follows its samples.
#[inline(never)]
pub fn smoothed(samples: &[u32; 8], rounds: u32) -> u32 {
    let mut level = 1;
    for _ in 0..rounds {
        for sample in samples {
            level = level - level / 8 + sample / 8;
        }
    }
    level
}

/// Waits for a bit.
#[inline(never)]
pub fn wait() {
    while input() & 1 == 0 {}
}

static WAS_MASKED: AtomicBool = AtomicBool::new(false);

/// Masks all interrupts, and notes whether they were masked before, as a logger does.
#[inline(never)]
pub fn mask() {
    let was_masked = cortex_m::register::primask::read().is_inactive();
    cortex_m::interrupt::disable();
    WAS_MASKED.store(was_masked, Ordering::Relaxed);
}

/// Notes something else in place of it.
#[inline(never)]
pub fn forget() {
    WAS_MASKED.store(input() & 1 == 0, Ordering::Relaxed);
}

/// Unmasks them, unless they were masked before [`mask`].
#[inline(never)]
pub fn unmask() {
    if !WAS_MASKED.load(Ordering::Relaxed) {
        // SAFETY: whoever called `mask` was not in a critical section.
        unsafe { cortex_m::interrupt::enable() };
    }
}

/// Bytes of a log, and where they begin: as a debugger finds them, so no compiler knows the address.
struct Channel {
    begin: AtomicPtr<AtomicU8>,
    next: AtomicU32,
}

static RECORDS: [AtomicU8; 64] = [const { AtomicU8::new(0) }; 64];
#[used]
static CHANNEL: Channel = Channel {
    begin: AtomicPtr::new(RECORDS.as_ptr().cast_mut()),
    next: AtomicU32::new(0),
};

/// Writes a byte of a log.
#[inline(never)]
pub fn record(byte: u8) {
    let begin = CHANNEL.begin.load(Ordering::Relaxed);
    let next = CHANNEL.next.load(Ordering::Relaxed) % 64;
    CHANNEL.next.store(next + 1, Ordering::Relaxed);
    // SAFETY: nothing changes the address, and there are 64 bytes.
    unsafe { (*begin.add(next as usize)).store(byte, Ordering::Relaxed) };
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
