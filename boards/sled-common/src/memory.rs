//! Test of the memory that the program uses, before the program uses it.
//!
//! Directly after a reset, before variables have their first values, a march test (March C-, van
//! de Goor, "Testing Semiconductor Memories", 1991) runs over the stack and over the memory of the
//! variables. It finds bits that are stuck, bits that do not change, wrong address lines, and
//! bits that change with one of another word. It is assembly, because the stack is being tested and no
//! variable is valid yet. The fault record of the last run and the time that it kept survive in registers.
//!
//! A debug probe that polls its control block may write to the memory meanwhile. So under a debugger
//! (C_DEBUGEN of DHCSR, ARMv7-M manual C1.6.2) a march that finds a defect runs again from the
//! beginning, and only the second finding counts: a broken bit is found twice. Without a debugger the
//! first finding counts, because a bit may fail only now and then. A probe sets C_DEBUGEN when it
//! attaches; only the probe or a power cycle clears it.
//!
//! The watchdog starts before it, with the period after a reset (0.2 s or more), so that not even a defect that stops
//! the core in here is without an end. Before that it is frozen for the time in which a debugger
//! halts the core.

#[cfg(target_os = "none")]
mod march {
    use core::cell::UnsafeCell;
    use core::mem::MaybeUninit;

    struct Defect(UnsafeCell<MaybeUninit<u32>>);

    // SAFETY: written before the program begins, and only read by it.
    unsafe impl Sync for Defect {}

    // SAFETY: `.uninit` is RAM that cortex-m-rt's start-up code leaves alone.
    #[unsafe(link_section = ".uninit.MEMORY_DEFECT")]
    static DEFECT: Defect = Defect(UnsafeCell::new(MaybeUninit::uninit()));

    // cortex-m-rt calls this first of all. r5 keeps the fault record, r10 and r11 the time,
    // r6 the address of the first defect, r7 and r8 the two patterns, r9 the marches left under a
    // debugger.
    core::arch::global_asm!(
        ".section .text.__pre_init, \"ax\", %progbits",
        ".global __pre_init",
        ".type __pre_init, %function",
        ".thumb_func",
        "__pre_init:",
        // DBGMCU_APB1_FZ: DBG_IWDG_STOP (0xE0042008, bit 12 in both parts: RM0390 and RM0316, debug
        // support, "Debug MCU APB1 freeze register"). The bits that a debugger has set stay.
        "movw r0, #0x2008",
        "movt r0, #0xE004",
        "ldr r1, [r0]",
        "orr r1, #0x1000",
        "str r1, [r0]",
        // IWDG_KR: start.
        "movw r0, #0x3000",
        "movt r0, #0x4000",
        "movw r1, #0xCCCC",
        "str r1, [r0]",
        "mov r12, lr",
        "movw r4, #:lower16:{record}",
        "movt r4, #:upper16:{record}",
        "ldr r5, [r4]",
        "movw r0, #:lower16:{kept}",
        "movt r0, #:upper16:{kept}",
        "ldrd r10, r11, [r0]",
        "mov r7, #-1",
        "mov r8, #0",
        "mov r9, #2",
        "9:",
        "movs r6, #0",
        "movw r0, #:lower16:_stack_end",
        "movt r0, #:upper16:_stack_end",
        "movw r1, #:lower16:_stack_start",
        "movt r1, #:upper16:_stack_start",
        "bl 20f",
        "cmp r6, #0",
        "bne 10f",
        "movw r0, #:lower16:_ram_start",
        "movt r0, #:upper16:_ram_start",
        "movw r1, #:lower16:__sheap",
        "movt r1, #:upper16:__sheap",
        "bl 20f",
        "10:",
        "cmp r6, #0",
        "beq 11f",
        "subs r9, #1",
        "beq 11f",
        // DHCSR: C_DEBUGEN is bit 0.
        "movw r0, #0xEDF0",
        "movt r0, #0xE000",
        "ldr r0, [r0]",
        "lsls r0, r0, #31",
        "bne 9b",
        "11:",
        "str r5, [r4]",
        "movw r4, #:lower16:{kept}",
        "movt r4, #:upper16:{kept}",
        "strd r10, r11, [r4]",
        "movw r4, #:lower16:{defect}",
        "movt r4, #:upper16:{defect}",
        "str r6, [r4]",
        "mov lr, r12",
        "bx lr",
        // The march over the words from r0 up to r1.
        "20:",
        "mov r2, r0",
        "21:",
        "str r8, [r2], #4",
        "cmp r2, r1",
        "blo 21b",
        "mov r2, r0",
        "22:",
        "ldr r3, [r2]",
        "cmp r3, r8",
        "bne 30f",
        "str r7, [r2], #4",
        "cmp r2, r1",
        "blo 22b",
        "mov r2, r0",
        "23:",
        "ldr r3, [r2]",
        "cmp r3, r7",
        "bne 30f",
        "str r8, [r2], #4",
        "cmp r2, r1",
        "blo 23b",
        "mov r2, r1",
        "24:",
        "ldr r3, [r2, #-4]!",
        "cmp r3, r8",
        "bne 30f",
        "str r7, [r2]",
        "cmp r2, r0",
        "bhi 24b",
        "mov r2, r1",
        "25:",
        "ldr r3, [r2, #-4]!",
        "cmp r3, r7",
        "bne 30f",
        "str r8, [r2]",
        "cmp r2, r0",
        "bhi 25b",
        "mov r2, r0",
        "26:",
        "ldr r3, [r2]",
        "cmp r3, r8",
        "bne 30f",
        "add r2, #4",
        "cmp r2, r1",
        "blo 26b",
        "bx lr",
        "30:",
        "mov r6, r2",
        "bx lr",
        ".size __pre_init, . - __pre_init",
        ".text",
        record = sym crate::fault::RECORD,
        kept = sym crate::kept::PLACE,
        defect = sym DEFECT,
    );

    /// The first word of memory that did not hold what was written to it.
    pub fn defect() -> Option<u32> {
        // SAFETY: RAM of ours, written before the program began; any bit pattern is a valid `u32`.
        let address = unsafe { DEFECT.0.get().cast::<u32>().read_volatile() };
        (address != 0).then_some(address)
    }
}

#[cfg(target_os = "none")]
pub use march::defect;

/// On a PC there is nothing to test.
#[cfg(not(target_os = "none"))]
pub const fn defect() -> Option<u32> {
    None
}
