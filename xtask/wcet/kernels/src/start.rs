//! A pointer that start-up leaves in memory, and handlers that use or change it.

use core::arch::asm;
use core::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

static VALUES: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];
static OTHERS: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];
static PLACE: AtomicPtr<AtomicU32> = AtomicPtr::new(core::ptr::null_mut());
static CHOICE: AtomicPtr<AtomicU32> = AtomicPtr::new(core::ptr::null_mut());
static PLACES: [AtomicPtr<AtomicU32>; 16] = [const { AtomicPtr::new(core::ptr::null_mut()) }; 16];
static CLAIMED: AtomicU32 = AtomicU32::new(0);
/// The analysis does not know this value.
#[used]
static FOUND: AtomicU32 = AtomicU32::new(1);

/// Sets a pointer and enables interrupts.
pub fn set_up() {
    PLACE.store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: neither the analysis nor the emulator raises an interrupt in this program.
    unsafe { asm!("cpsie i") };
}

/// The same, after a stretch in which only interrupts of priority value 0 are served.
pub fn set_up_with_an_alarm() {
    set_up_masked::<0x10>();
}

/// The same, after a stretch in which a task of the highest priority is served.
pub fn set_up_with_a_task() {
    set_up_masked::<0x20>();
}

#[inline(always)]
fn set_up_masked<const BASEPRI: u32>() {
    // SAFETY: as in `set_up`.
    unsafe { asm!("msr basepri, {}", "cpsie i", in(reg) BASEPRI) };
    PLACE.store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: as in `set_up`.
    unsafe { asm!("cpsid i", "msr basepri, {}", "cpsie i", in(reg) 0) };
}

/// Lets tasks run by the mask that was found at the beginning.
pub fn set_up_by_the_mask_before() {
    // SAFETY: as in `set_up`.
    unsafe {
        asm!(
            "mrs {before}, basepri",
            "msr basepri, {masked}",
            "cpsie i",
            "msr basepri, {before}",
            before = out(reg) _,
            masked = in(reg) 0x10,
        )
    };
    PLACE.store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: as in `set_up`.
    unsafe { asm!("cpsid i", "cpsie i") };
}

/// Masks all tasks on one of two paths.
pub fn set_up_on_two_paths() {
    if FOUND.load(Ordering::Relaxed) == 0 {
        // SAFETY: as in `set_up`.
        unsafe { asm!("msr basepri, {}", in(reg) 0x10) };
    }
    // SAFETY: as in `set_up`.
    unsafe { asm!("cpsie i") };
    PLACE.store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: as in `set_up`.
    unsafe { asm!("cpsid i", "msr basepri, {}", "cpsie i", in(reg) 0) };
}

/// Sets the pointer if a variable in `.bss` is still zero.
pub fn set_up_if_unclaimed() {
    if CLAIMED.load(Ordering::Relaxed) == 0 {
        set_up();
    }
    // SAFETY: as in `set_up`.
    unsafe { asm!("cpsie i") };
}

/// The same after a store of an unknown word to that variable.
pub fn set_up_if_still_unclaimed() {
    CLAIMED.store(FOUND.load(Ordering::Relaxed), Ordering::Relaxed);
    set_up_if_unclaimed();
}

/// Sets one of several pointers and enables interrupts.
pub fn set_up_an_element() {
    PLACES[3].store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: as in `set_up`.
    unsafe { asm!("cpsie i") };
}

/// Sets the pointer byte by byte and halfword by halfword, as compilers do beside fields of that size.
pub fn set_up_in_parts() {
    set_up_from_parts(VALUES.as_ptr().addr() >> 24);
}

/// The same with an upper byte that nobody knows.
pub fn set_up_in_parts_but_one() {
    set_up_from_parts(FOUND.load(Ordering::Relaxed) as usize);
}

#[inline(always)]
fn set_up_from_parts(last: usize) {
    let values = VALUES.as_ptr().addr();
    // SAFETY: it stores a pointer to `VALUES`, but for its last byte, to `PLACE`, which nobody follows here.
    unsafe {
        asm!(
            "cpsid i",
            "strb {last}, [{place}, #3]",
            "strb {values}, [{place}]",
            "lsrs {values}, {values}, #8",
            "strh {values}, [{place}, #1]",
            "cpsie i",
            place = in(reg) &raw const PLACE,
            values = inout(reg) values => _,
            last = in(reg) last,
        )
    };
}

/// Changes the words to which the pointer leads.
pub fn use_pointer() {
    let place = PLACE.load(Ordering::Relaxed);
    for distance in 0..8 {
        // SAFETY: the pointer leads to the first of sixteen elements.
        let value = unsafe { &*place.add(distance) };
        value.store(value.load(Ordering::Relaxed) ^ 5, Ordering::Relaxed);
    }
}

/// Changes the words to which the second pointer leads, if it is set.
pub fn use_choice() {
    // SAFETY: the pointer is null or leads to the first of sixteen elements.
    if let Some(words) = unsafe { CHOICE.load(Ordering::Relaxed).cast::<[AtomicU32; 8]>().as_ref() } {
        for word in words {
            word.store(word.load(Ordering::Relaxed) ^ 5, Ordering::Relaxed);
        }
    }
}

/// Sets the second pointer to what the first one is.
pub fn choose() {
    CHOICE.store(PLACE.load(Ordering::Relaxed), Ordering::Relaxed);
}

/// Sets the second pointer to another array.
pub fn choose_another() {
    CHOICE.store(OTHERS.as_ptr().cast_mut(), Ordering::Relaxed);
}

/// Sets the second pointer to anything.
pub fn choose_anything() {
    let word = VALUES[0].load(Ordering::Relaxed) as usize;
    CHOICE.store(core::ptr::without_provenance_mut(word), Ordering::Relaxed);
}

/// Writes to an element with an unknown index.
pub fn use_index() {
    let index = VALUES[0].load(Ordering::Relaxed) as usize;
    if let Some(value) = OTHERS.get(index) {
        value.store(3, Ordering::Relaxed);
    }
}

/// Adds eight elements of an array. The analysis knows nothing about their indices.
pub fn use_any_index() {
    let mut sum = 0_u32;
    for value in &OTHERS[..8] {
        let index = value.load(Ordering::Relaxed) as usize;
        // SAFETY: the analysis does not know the elements of `OTHERS`; all are zero.
        let value = unsafe { VALUES.get_unchecked(index) };
        sum = sum.wrapping_add(value.load(Ordering::Relaxed));
    }
    OTHERS[0].store(sum & 1, Ordering::Relaxed);
}

/// Changes the word to which one of several pointers leads.
pub fn use_element() {
    let place = PLACES[3].load(Ordering::Relaxed);
    // SAFETY: the pointer leads to the first of sixteen elements.
    unsafe { &*place }.store(5, Ordering::Relaxed);
}

/// Sets one of these pointers, by an index of which `FROM` is the least.
#[inline(always)]
fn move_element<const FROM: usize>() {
    let index = OTHERS[0].load(Ordering::Relaxed) as usize;
    // SAFETY: the analysis does not know the index. Nothing runs this function.
    let place = unsafe { PLACES.get_unchecked(index.wrapping_sub(FROM)) };
    place.store(OTHERS.as_ptr().cast_mut(), Ordering::Relaxed);
}

/// By an index from zero on.
pub fn move_any_element() {
    move_element::<0>();
}

/// By an index from a number on, so that the compiler's address lies in front of the array.
pub fn move_folded_element() {
    move_element::<40>();
}

/// The same, and that address is in front of all of memory.
pub fn move_far_folded_element() {
    move_element::<200_000>();
}

/// Makes the pointer lead to another array.
pub fn move_pointer() {
    PLACE.store(OTHERS.as_ptr().cast_mut(), Ordering::Relaxed);
}

/// Writes to an unknown address.
pub fn write_anywhere(place: &AtomicU32) {
    place.store(1, Ordering::Relaxed);
}

/// Has a conditional instruction between the halves of a number whose lower half is that of a
/// function's address, and elsewhere the upper half of that address.
pub fn load_a_number() {
    // SAFETY: it changes registers and flags only.
    unsafe {
        asm!(
            "movw {word}, #:lower16:{function}",
            "it hi",
            "addhi {other}, #1",
            "movt {word}, #1",
            "movw {word}, #0",
            "movt {word}, #:upper16:{function}",
            function = sym never_taken,
            word = out(reg) _,
            other = inout(reg) 0_u32 => _,
        )
    };
}

/// A conditional instruction may leave the lower half in its register.
pub fn load_a_pointer() {
    // SAFETY: it changes registers and flags only.
    unsafe {
        asm!(
            "movw {word}, #:lower16:{function}",
            "it hi",
            "movhi {word}, {other}",
            "movt {word}, #:upper16:{function}",
            function = sym taken,
            word = out(reg) _,
            other = in(reg) 0_u32,
        )
    };
}

/// A function of which no pointer is made.
#[inline(never)]
pub fn never_taken() {
    // SAFETY: it does nothing.
    unsafe { asm!("nop") };
}

/// A function of which a pointer is made.
#[inline(never)]
pub fn taken() {
    // SAFETY: it does nothing.
    unsafe { asm!("nop", "nop") };
}
