//! Kernels for the execution-time analysis.
//!
//! Each is a function of one block of input words, which it may overwrite. No code here calls
//! them: the analysis and the emulator enter each one through [`KERNELS`]. Those with instructions that a Cortex-M0
//! does not have are left out for it.

#![no_std]
#![no_main]

mod arithmetic;
mod arrays;
#[cfg(target_has_atomic = "32")]
mod broken;
mod control;
#[cfg(target_has_atomic = "32")]
mod ends;
#[cfg(target_has_atomic = "32")]
mod masked;
#[cfg(target_has_atomic = "32")]
mod received;
#[cfg(target_has_atomic = "32")]
mod start;
mod text;

use core::panic::PanicInfo;

/// Number of input words of every kernel.
pub const WORDS: usize = 64;
/// The input of a kernel.
pub type Input = [u32; WORDS];
/// A kernel.
pub type Kernel = fn(&mut Input) -> u32;

/// Every kernel. The table makes the linker keep them.
#[used]
pub static KERNELS: [Kernel; 39] = [
    arithmetic::divide_u32,
    arithmetic::divide_u64,
    arithmetic::divide_i64,
    arithmetic::remainder_u64,
    arithmetic::polynomial_f32,
    arithmetic::polynomial_f64,
    arithmetic::divide_f64,
    arithmetic::root_f32,
    arithmetic::product_u64,
    arithmetic::greatest_divisor,
    arithmetic::bits_set,
    arithmetic::fixed_point_filter,
    arrays::nested,
    arrays::triangular,
    arrays::matrix_f32,
    arrays::matrix_i32,
    arrays::insertion_sort,
    arrays::bubble_sort,
    arrays::heap_sort,
    arrays::binary_search,
    arrays::copy_some,
    arrays::copy_all,
    arrays::compare_some,
    arrays::fill_some,
    arrays::sieve,
    arrays::median,
    control::early_exit,
    control::table_jump,
    control::pointer_table,
    control::state_machine,
    control::choices,
    control::merged,
    control::repeated_from_within,
    control::searches,
    text::crc8_bits,
    text::crc32_table,
    text::decimal,
    text::parse_number,
    text::hexadecimal,
];

/// Functions without a bound, or with a false one.
#[cfg(target_has_atomic = "32")]
#[used]
pub static BROKEN: [Kernel; 6] = [
    broken::endless_wait,
    broken::spin_lock,
    broken::recursion,
    broken::annotated_too_low,
    broken::never_left,
    broken::without_end,
];

/// A function that calls through the pointer in its argument.
#[cfg(target_has_atomic = "32")]
#[used]
pub static POINTER: fn(&mut fn(u32) -> u32) -> u32 = broken::pointer_from_memory;

/// A start-up function, and handlers that may run after it.
#[cfg(target_has_atomic = "32")]
#[used]
pub static HANDLERS: [fn(); 24] = [
    start::set_up,
    start::set_up_with_an_alarm,
    start::set_up_with_a_task,
    start::set_up_by_the_mask_before,
    start::set_up_on_two_paths,
    start::set_up_if_unclaimed,
    start::set_up_if_still_unclaimed,
    start::set_up_in_parts,
    start::set_up_an_element,
    start::use_element,
    start::move_any_element,
    start::move_folded_element,
    start::move_far_folded_element,
    start::set_up_in_parts_but_one,
    start::use_pointer,
    start::use_index,
    start::use_any_index,
    start::use_choice,
    start::choose,
    start::choose_another,
    start::choose_anything,
    start::move_pointer,
    start::load_a_number,
    start::load_a_pointer,
];

/// Programs and handlers that mask interrupts.
#[cfg(target_has_atomic = "32")]
#[used]
pub static MASKED: [fn(); 31] = [
    masked::wait_by_primask,
    masked::wait_by_faultmask,
    masked::wait_by_faultmask_register,
    masked::wait_by_basepri,
    masked::wait_by_basepri_max,
    masked::wait_in_a_call,
    masked::count_by_primask,
    masked::count_past_pointer,
    masked::unmask_past_pointer,
    masked::count_by_faultmask,
    masked::sleep_by_primask,
    masked::sleep_by_basepri,
    masked::wait_for_event_by_primask,
    masked::wait_at_the_start,
    masked::wait_unmasked,
    masked::wait_across_turns,
    masked::wait_for_good,
    masked::return_masked,
    masked::return_raised,
    masked::return_faultmask,
    masked::lock,
    masked::nest_lower,
    masked::hand_down,
    masked::hand_round,
    masked::restore_unknown,
    masked::raise_to_unknown,
    masked::restore_overwritten,
    masked::restore_beside_checked_index,
    masked::restore_past_pointer,
    masked::disable_interrupt,
    masked::sleep_in_a_handler,
];

/// Handlers that read from a device which path to take.
#[cfg(target_has_atomic = "32")]
#[used]
pub static RECEIVED: [fn(); 5] = [
    received::take,
    received::take_next,
    received::take_two,
    received::take_or_skip,
    received::take_by_mask,
];

/// Handlers that do not return.
#[cfg(target_has_atomic = "32")]
#[used]
pub static ENDS: [fn(); 3] = [ends::reset, ends::group, ends::stop];

/// A handler that may not return.
#[cfg(target_has_atomic = "32")]
#[used]
pub static MAY_END: fn(&u32) = ends::maybe_return;

/// A handler that writes through the pointer in its argument.
#[cfg(target_has_atomic = "32")]
#[used]
pub static ANYWHERE: fn(&core::sync::atomic::AtomicU32) = start::write_anywhere;

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
