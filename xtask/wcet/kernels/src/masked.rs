//! Programs that mask interrupts after a task could run, and handlers that leave them masked.

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering};

static FLAG: AtomicU32 = AtomicU32::new(0);

/// A program that lets tasks run, masks interrupts by `$mask`, runs `$body` and unmasks them by
/// `$unmask`.
macro_rules! section {
    ($name:ident, $mask:literal, $unmask:literal, $body:expr) => {
        #[doc = concat!("Between `", $mask, "` and `", $unmask, "`.")]
        pub fn $name() {
            // SAFETY: neither the analysis nor the emulator raises an interrupt in this program.
            unsafe {
                asm!("cpsie i");
                asm!($mask, out("r1") _);
            }
            $body;
            // SAFETY: as above.
            unsafe { asm!($unmask, out("r1") _) };
        }
    };
}

section!(wait_by_primask, "cpsid i", "cpsie i", wait());
section!(wait_by_faultmask, "cpsid f", "cpsie f", wait());
section!(
    wait_by_faultmask_register,
    "movs r1, #1; msr faultmask, r1",
    "movs r1, #0; msr faultmask, r1",
    wait()
);
section!(
    wait_by_basepri,
    "movs r1, #0x50; msr basepri, r1",
    "movs r1, #0; msr basepri, r1",
    wait()
);
section!(
    wait_by_basepri_max,
    "movs r1, #0x50; msr basepri_max, r1",
    "movs r1, #0; msr basepri, r1",
    wait()
);
section!(wait_in_a_call, "cpsid i", "cpsie i", wait_out_of_line());
section!(count_by_primask, "cpsid i", "cpsie i", count());
section!(count_by_faultmask, "cpsid f", "cpsie f", count());
section!(sleep_by_primask, "cpsid i", "cpsie i", sleep());
section!(
    sleep_by_basepri,
    "movs r1, #0x50; msr basepri, r1",
    "movs r1, #0; msr basepri, r1",
    sleep()
);
section!(wait_for_event_by_primask, "cpsid i", "cpsie i", doze());

/// Waits with interrupts masked before any task could run.
pub fn wait_at_the_start() {
    // SAFETY: as in `section`.
    unsafe { asm!("cpsid i") };
    wait();
    // SAFETY: as in `section`.
    unsafe { asm!("cpsie i") };
}

/// Waits without a mask, as the idle code may.
pub fn wait_unmasked() {
    // SAFETY: as in `section`.
    unsafe { asm!("cpsie i") };
    wait();
}

/// Masks interrupts in one turn and unmasks them in a later one.
pub fn wait_across_turns() {
    // SAFETY: as in `section`.
    unsafe { asm!("cpsie i") };
    while FLAG.load(Ordering::Relaxed) != 9 {
        if FLAG.load(Ordering::Relaxed) == 1 {
            // SAFETY: as in `section`.
            unsafe { asm!("cpsid i") };
        }
        if FLAG.load(Ordering::Relaxed) == 2 {
            // SAFETY: as in `section`.
            unsafe { asm!("cpsie i") };
        }
    }
}

/// Ends with interrupts masked for good.
pub fn wait_for_good() {
    // SAFETY: as in `section`.
    unsafe { asm!("cpsie i", "cpsid i") };
    loop {
        FLAG.store(1, Ordering::Relaxed);
    }
}

#[inline(always)]
fn wait() {
    while FLAG.load(Ordering::Relaxed) == 0 {}
}

#[inline(never)]
fn wait_out_of_line() {
    wait();
}

#[inline(always)]
fn count() {
    // loop-bound: 3000 the flag counts to no more
    for _ in 0..FLAG.load(Ordering::Relaxed) {
        // SAFETY: it does nothing.
        unsafe { asm!("nop") };
    }
}

#[inline(always)]
fn sleep() {
    // SAFETY: it waits only.
    unsafe { asm!("wfi") };
}

#[inline(always)]
fn doze() {
    // SAFETY: it waits only.
    unsafe { asm!("wfe") };
}

/// A handler that returns with interrupts masked.
pub fn return_masked() {
    // SAFETY: as in `section`.
    unsafe { asm!("cpsid i") };
}

/// A handler that returns with `BASEPRI` raised.
pub fn return_raised() {
    // SAFETY: as in `section`.
    unsafe { asm!("movs r1, #0x50; msr basepri, r1", out("r1") _) };
}

/// A handler that returns with `FAULTMASK` set, which the return clears.
pub fn return_faultmask() {
    // SAFETY: as in `section`.
    unsafe { asm!("cpsid f") };
}

/// A handler that raises `BASEPRI` and restores what it found there.
pub fn lock() {
    // SAFETY: as in `section`.
    unsafe {
        asm!(
            "mrs {before}, basepri",
            "msr basepri_max, {raised}",
            "nop",
            "msr basepri, {before}",
            before = out(reg) _,
            raised = in(reg) 0x50,
        );
    }
}

/// Raises `BASEPRI` to `level`, unless it masks more already, and returns what it was.
#[inline(always)]
fn raise(level: u32) -> u32 {
    let before;
    // SAFETY: as in `section`.
    unsafe {
        asm!(
            "mrs {before}, basepri",
            "msr basepri_max, {level}",
            before = out(reg) before,
            level = in(reg) level,
        );
    }
    before
}

#[inline(always)]
fn restore(before: u32) {
    // SAFETY: as in `section`.
    unsafe { asm!("msr basepri, {before}", before = in(reg) before) };
}

/// A handler with three sections, one in the other. The two inner ones mask less, so they change nothing.
pub fn nest_lower() {
    let first = raise(0x20);
    let second = raise(0x50);
    let third = raise(0x40);
    restore(third);
    count();
    restore(second);
    restore(first);
}

/// A handler that masks the priorities from 0x50 on without a gap, but by other means from one third of the time to the next.
pub fn hand_down() {
    let found = raise(0x20);
    count();
    restore(0x50);
    count();
    restore(found);
}

/// The same, from `BASEPRI` to `PRIMASK` and back.
pub fn hand_round() {
    let found = raise(0x50);
    count();
    // SAFETY: as in `section`.
    unsafe { asm!("cpsid i") };
    restore(found);
    count();
    raise(0x50);
    // SAFETY: as in `section`.
    unsafe { asm!("cpsie i") };
    count();
    restore(found);
}

/// A handler that restores an unknown word.
pub fn restore_unknown() {
    raise(0x50);
    restore(FLAG.load(Ordering::Relaxed));
}

/// A handler that raises `BASEPRI` to an unknown level.
pub fn raise_to_unknown() {
    let before = raise(FLAG.load(Ordering::Relaxed));
    restore(before);
}

/// A handler that keeps what it found in `BASEPRI` in an array, and stores to an element without a check.
pub fn restore_overwritten() {
    let mut kept = [0_u32; 8];
    let first = kept.as_mut_ptr();
    let index = FLAG.load(Ordering::Relaxed) as usize % 8;
    // SAFETY: all of it is in the array. The accesses are volatile so that the words are on the stack.
    unsafe {
        first.write_volatile(raise(0x50));
        first.add(index).write_volatile(0);
        restore(first.read_volatile());
    }
}

/// A handler that checks an index by one extension to a byte, and uses it by another. What it found in
/// `BASEPRI` is behind the elements that it stores to.
pub fn restore_beside_checked_index() {
    let mut kept = [0_u32; 8];
    let first = kept.as_mut_ptr();
    // SAFETY: as in `restore_overwritten`; one of the first 16 bytes is stored to.
    unsafe {
        first.add(7).write_volatile(raise(0x50));
        asm!(
            "uxtb {checked}, {index}",
            "cmp {checked}, #15",
            "bhi 2f",
            "uxtab {at}, {at}, {index}",
            "strb {index}, [{at}]",
            "2:",
            checked = out(reg) _,
            index = in(reg) FLAG.load(Ordering::Relaxed),
            at = inout(reg) first => _,
        );
        restore(first.add(7).read_volatile());
    }
}

/// A handler that stores through a pointer from memory while it keeps what it found in `BASEPRI` on its
/// stack, whose address is in memory, too.
pub fn restore_past_pointer() {
    let mut kept = [0_u32; 8];
    let first = kept.as_mut_ptr();
    FLAG.store(first.expose_provenance() as u32, Ordering::Relaxed);
    // SAFETY: as in `restore_overwritten`. The pointer is not followed but in the analysis.
    unsafe {
        first.write_volatile(raise(0x50));
        let address = FLAG.load(Ordering::Relaxed) as usize;
        let other = core::ptr::with_exposed_provenance_mut::<u32>(address);
        other.add(4).write_volatile(0);
        restore(first.read_volatile());
    }
}

/// A program that stores through a pointer from memory while it keeps what it read from `PRIMASK` on its stack,
/// whose address is in memory, too.
pub fn unmask_past_pointer() {
    let mut kept = [0_u32; 8];
    let first = kept.as_mut_ptr();
    FLAG.store(first.expose_provenance() as u32, Ordering::Relaxed);
    // SAFETY: as in `restore_past_pointer`.
    unsafe {
        let found: u32;
        asm!("cpsie i", "mrs {found}, primask", "cpsid i", found = out(reg) found);
        first.write_volatile(found);
        let address = FLAG.load(Ordering::Relaxed) as usize;
        let other = core::ptr::with_exposed_provenance_mut::<u32>(address);
        other.add(4).write_volatile(0);
        asm!("msr primask, {found}", found = in(reg) first.read_volatile());
    }
}

/// A program that keeps a counter in a register which a function saves on the stack while it stores through a
/// pointer from memory; the address of the stack is there, too. The section takes three turns of it.
pub fn count_past_pointer() {
    // SAFETY: as in `section`. The pointer is not followed but in the analysis.
    unsafe {
        asm!(
            "cpsie i",
            "cpsid i",
            "str sp, [r0]",
            "movs r4, #3",
            "2:",
            "bl {store}",
            "subs r4, #1",
            "bne 2b",
            "cpsie i",
            store = sym store_through_pointer,
            in("r0") FLAG.as_ptr(),
            out("r4") _,
            out("lr") _,
        );
    }
}

/// Saves a register, stores through the pointer at `r0` and restores the register.
#[unsafe(naked)]
unsafe extern "C" fn store_through_pointer() {
    core::arch::naked_asm!(
        "push {{r4, lr}}",
        "ldr r4, [r0]",
        "str r4, [r4]",
        "pop {{r4, pc}}"
    )
}

/// A handler that disables the first interrupt in the interrupt controller.
pub fn disable_interrupt() {
    let register = core::ptr::with_exposed_provenance_mut::<u32>(0xE000_E180);
    // SAFETY: the register is there on every core, and the emulator never runs this.
    unsafe { register.write_volatile(1) };
}

/// A handler that sleeps.
pub fn sleep_in_a_handler() {
    sleep();
}
