//! The record of the last fault, which outlives a reset.
//!
//! A panic or a hard fault writes one word to memory that start-up does not clear, stops the
//! board's actuator and resets the microcontroller. Nothing is formatted: the images carry no
//! panic messages. The node reads the word once after the reset and reports it in its status
//! message.

/// What went wrong last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A Rust panic.
    Panic,
    /// A hard fault of the processor (bus fault, undefined instruction, stack
    /// overflow: the stack ends at an address without memory).
    Hard,
    /// An interrupt that no task is bound to.
    Unhandled,
    /// The external clock stopped. After the reset the node runs on the RC oscillator.
    Clock,
    /// The node could not be started: for example, a converter did not get ready, or the
    /// protocol stack refused its schedule.
    Start,
    /// A clock did not get ready: the oscillator, the PLL or the voltage regulator.
    ClockStart,
    /// No fault: the external clock has come, and the node starts again to use it.
    ClockFound,
    /// No fault: there is neither an external clock nor another time master, and the node starts
    /// again to lead on its RC oscillator.
    LastResort,
    /// No fault: a program on the bus asked for the whole self-test.
    SelfTest,
    /// The supply fell, or did not come, to what the part needs for its clock.
    Supply,
}

impl Fault {
    /// The number that stands for this fault in the record and in event messages.
    pub const fn code(self) -> u8 {
        match self {
            Self::Panic => 1,
            Self::Hard => 2,
            Self::Unhandled => 3,
            Self::Start => 4,
            Self::Clock => 5,
            Self::ClockStart => 6,
            Self::ClockFound => 7,
            Self::LastResort => 8,
            Self::SelfTest => 9,
            Self::Supply => 10,
        }
    }

    #[cfg(any(target_os = "none", test))]
    const fn from_code(code: u8) -> Option<Self> {
        match code {
            1 => Some(Self::Panic),
            2 => Some(Self::Hard),
            3 => Some(Self::Unhandled),
            4 => Some(Self::Start),
            5 => Some(Self::Clock),
            6 => Some(Self::ClockStart),
            7 => Some(Self::ClockFound),
            8 => Some(Self::LastResort),
            9 => Some(Self::SelfTest),
            10 => Some(Self::Supply),
            _ => None,
        }
    }

    /// The word that is stored: the code behind a marker, which random memory after power-up is
    /// unlikely to hold.
    #[cfg(any(target_os = "none", test))]
    const fn word(self) -> u32 {
        0xFA17_5A00 | self.code() as u32
    }

    #[cfg(any(target_os = "none", test))]
    const fn from_word(word: u32) -> Option<Self> {
        if word & 0xFFFF_FF00 == 0xFA17_5A00 {
            Self::from_code(word as u8)
        } else {
            None
        }
    }
}

#[cfg(target_os = "none")]
mod record {
    use super::Fault;
    use core::cell::UnsafeCell;
    use core::mem::MaybeUninit;

    pub(crate) struct Record(UnsafeCell<MaybeUninit<u32>>);

    // SAFETY: accessed volatile, one aligned word at a time, on a single core.
    unsafe impl Sync for Record {}

    // SAFETY: `.uninit` is RAM that cortex-m-rt's start-up code leaves alone.
    #[unsafe(link_section = ".uninit.FAULT_RECORD")]
    pub(crate) static RECORD: Record = Record(UnsafeCell::new(MaybeUninit::uninit()));

    /// Takes the fault that led to this start, if one did.
    pub fn take() -> Option<Fault> {
        let word = RECORD.0.get().cast::<u32>();
        // SAFETY: RAM of ours; any bit pattern is a valid `u32`.
        let found = unsafe { word.read_volatile() };
        // SAFETY: as above.
        unsafe { word.write_volatile(0) };
        Fault::from_word(found)
    }

    /// Notes what the program is about to wait for. If the watchdog ends the wait, the next start
    /// finds it.
    pub fn expect(fault: Fault) {
        // SAFETY: RAM of ours; only start-up writes it.
        unsafe { RECORD.0.get().cast::<u32>().write_volatile(fault.word()) };
    }

    /// The program waits for nothing any more.
    pub fn passed() {
        // SAFETY: as above.
        unsafe { RECORD.0.get().cast::<u32>().write_volatile(0) };
    }

    /// Notes the fault and resets the microcontroller.
    ///
    /// The caller must have stopped its actuator. After the reset, start-up sends the stop
    /// command once more.
    pub fn reset(fault: Fault) -> ! {
        // SAFETY: RAM of ours; nothing else runs any more.
        unsafe { RECORD.0.get().cast::<u32>().write_volatile(fault.word()) };
        cortex_m::peripheral::SCB::sys_reset()
    }
}

#[cfg(target_os = "none")]
pub(crate) use record::RECORD;
#[cfg(target_os = "none")]
pub use record::{expect, passed, reset, take};

/// Notes what the program is about to wait for; on a PC there is nothing to note.
#[cfg(not(target_os = "none"))]
pub fn expect(_: Fault) {}

/// Defines the handlers of a hard fault, of a stopped external clock, and of an interrupt that
/// no task is bound to. Each stops the board's actuator by `$stop`, records the fault and
/// resets the part.
///
/// The hard fault's handler begins with an empty stack, because a stack overflow is one of its
/// causes.
#[macro_export]
macro_rules! fault_handlers {
    ($stop:path) => {
        #[cfg(target_os = "none")]
        mod fault_handlers {
            use $crate::fault::{Fault, reset};

            // The vector table of cortex-m-rt asks for this name. The code sets the stack
            // pointer before it uses the stack, and never returns to what that discards. It is
            // global assembly, because Debian's compiler does not support naked functions.
            core::arch::global_asm!(
                ".section .text.HardFault, \"ax\", %progbits",
                ".global HardFault",
                ".type HardFault, %function",
                ".thumb_func",
                "HardFault:",
                "movw r0, #:lower16:_stack_start",
                "movt r0, #:upper16:_stack_start",
                "msr msp, r0",
                "b {stop}",
                ".size HardFault, . - HardFault",
                ".text",
                stop = sym stop_hard,
            );

            extern "C" fn stop_hard() -> ! {
                $stop();
                reset(Fault::Hard)
            }

            // The interrupt of the clock security system; nothing else raises it on this board.
            // SAFETY: the name is the one that cortex-m-rt's vector table asks for.
            #[unsafe(export_name = "NonMaskableInt")]
            extern "C" fn clock_lost() -> ! {
                $stop();
                reset(Fault::Clock)
            }

            // SAFETY: the name is the one that cortex-m-rt's vector table asks for.
            #[unsafe(export_name = "DefaultHandler")]
            extern "C" fn unhandled() -> ! {
                $stop();
                reset(Fault::Unhandled)
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::Fault;

    #[test]
    fn a_record_is_told_from_random_memory() {
        for fault in [
            Fault::Panic,
            Fault::Hard,
            Fault::Unhandled,
            Fault::Start,
            Fault::Clock,
            Fault::ClockStart,
            Fault::ClockFound,
            Fault::LastResort,
            Fault::SelfTest,
            Fault::Supply,
        ] {
            assert_eq!(Fault::from_word(fault.word()), Some(fault));
        }
        for word in [0, 0xFFFF_FFFF, 0xFA17_5A00, 0xFA17_5B01, 0xFA17_5A0B] {
            assert_eq!(Fault::from_word(word), None);
        }
    }
}
