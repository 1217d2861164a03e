//! Latest proven time of the bus, which a reset leaves alone.
//!
//! A node that starts again follows no earlier time, and a time master goes on from it. It is lost with
//! the supply.

/// Marks a time that was kept: the second word is the first one exclusive-or this. Random memory after
/// power-up is unlikely to hold such a pair.
#[cfg(any(target_os = "none", test))]
const MARK: u32 = 0x7E3A_91C5;

#[cfg(any(target_os = "none", test))]
const fn words(time: u32) -> [u32; 2] {
    [time, time ^ MARK]
}

#[cfg(any(target_os = "none", test))]
const fn time_of([time, check]: [u32; 2]) -> Option<u32> {
    if time ^ check == MARK {
        Some(time)
    } else {
        None
    }
}

#[cfg(target_os = "none")]
mod place {
    use core::cell::UnsafeCell;
    use core::mem::MaybeUninit;

    pub(crate) struct Place(UnsafeCell<MaybeUninit<[u32; 2]>>);

    // SAFETY: accessed volatile, one aligned word at a time, on a single core.
    unsafe impl Sync for Place {}

    // SAFETY: `.uninit` is RAM that cortex-m-rt's start-up code leaves alone.
    #[unsafe(link_section = ".uninit.KEPT_TIME")]
    pub(crate) static PLACE: Place = Place(UnsafeCell::new(MaybeUninit::uninit()));

    /// Takes the time that was kept before the reset, ms; `None` after power-up.
    pub fn take() -> Option<u32> {
        let place = PLACE.0.get().cast::<u32>();
        // SAFETY: RAM of ours, two words; any bit pattern is a valid `u32`.
        let found = unsafe { [place.read_volatile(), place.add(1).read_volatile()] };
        super::time_of(found)
    }

    /// Keeps a time, ms. A reset between the two words loses it.
    pub fn put(time: u32) {
        let place = PLACE.0.get().cast::<u32>();
        let [time, check] = super::words(time);
        // SAFETY: RAM of ours, two words; only start-up reads it.
        unsafe {
            place.write_volatile(time);
            place.add(1).write_volatile(check);
        }
    }
}

#[cfg(target_os = "none")]
pub(crate) use place::PLACE;
#[cfg(target_os = "none")]
pub use place::{put, take};

#[cfg(test)]
mod tests {
    use super::{time_of, words};

    #[test]
    fn a_time_is_read_back_and_other_memory_is_none() {
        for time in [0, 1, 123_456_789, u32::MAX] {
            assert_eq!(time_of(words(time)), Some(time));
        }
        for memory in [[0; 2], [u32::MAX; 2], [5, 6]] {
            assert_eq!(time_of(memory), None);
        }
    }
}
