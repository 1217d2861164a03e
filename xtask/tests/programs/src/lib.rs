//! What the programs share: the vector table, inputs that no compiler knows, panics.

#![no_std]

use core::sync::atomic::{AtomicU32, Ordering};

/// An entry of the vector table.
pub type Handler = unsafe extern "C" fn();

/// Stack pointer, reset, one interrupt.
#[repr(C)]
pub struct Vectors(pub usize, pub Handler, pub Handler);

/// A number that an interrupt may change.
pub static INPUT: AtomicU32 = AtomicU32::new(3);

/// The input.
pub fn input() -> u32 {
    INPUT.load(Ordering::Relaxed)
}

/// Puts a result where the compiler cannot remove it.
pub fn output(value: u32) {
    INPUT.store(value, Ordering::Relaxed);
}

/// Defines vector table, start and panic handler of a program: `$work` is its interrupt.
#[macro_export]
macro_rules! program {
    ($work:path, $panic:expr) => {
        #[unsafe(link_section = ".vector_table")]
        #[used]
        static VECTORS: $crate::Vectors = $crate::Vectors(0x1000_1000, main, TIM2);

        /// The start.
        #[unsafe(no_mangle)]
        pub extern "C" fn main() {
            $crate::output(7);
        }

        /// The interrupt.
        #[unsafe(no_mangle)]
        pub extern "C" fn TIM2() {
            $work();
        }

        #[panic_handler]
        fn panic(info: &core::panic::PanicInfo) -> ! {
            let end: fn(&core::panic::PanicInfo) -> ! = $panic;
            end(info)
        }
    };
}

/// Ends a program without looking at the reason.
pub fn silent(_: &core::panic::PanicInfo) -> ! {
    loop {
        output(0);
    }
}
