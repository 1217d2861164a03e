//! May panic in a function that is only called through a pointer.

#![no_std]
#![no_main]

use core::sync::atomic::{AtomicPtr, Ordering};
use programs::{input, output, silent};

static HOOK: AtomicPtr<()> = AtomicPtr::new(core::ptr::null_mut());

#[inline(never)]
fn divide() {
    output(1000 / input());
}

#[inline(never)]
fn add() {
    output(1000_u32.wrapping_add(input()));
}

fn work() {
    let which: fn() = if input() > 5 { divide } else { add };
    HOOK.store(which as *mut (), Ordering::SeqCst);
    // SAFETY: what was just stored, or an interrupt's other choice of the two.
    let which: fn() = unsafe { core::mem::transmute(HOOK.load(Ordering::SeqCst)) };
    which();
}

programs::program!(work, silent);
