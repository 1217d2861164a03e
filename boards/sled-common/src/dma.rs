//! Memory that a DMA controller and the processor share.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

/// A static array that a DMA controller reads or writes behind the compiler's back.
///
/// The processor reaches it by volatile accesses only, so that the compiler neither
/// keeps elements in registers nor assumes that they stay.
#[repr(C, align(4))]
pub struct Shared<T, const N: usize> {
    cells: UnsafeCell<[T; N]>,
    taken: AtomicBool,
}

// SAFETY: the processor's accesses are volatile and go through the one `Window` that
// `take` hands out; the DMA controller's are single bus transfers of one element.
unsafe impl<T: Copy + Send, const N: usize> Sync for Shared<T, N> {}

impl<T: Copy + Send, const N: usize> Shared<T, N> {
    /// An array of `N` times `value`, for a `static`.
    pub const fn new(value: T) -> Self {
        Self {
            cells: UnsafeCell::new([value; N]),
            taken: AtomicBool::new(false),
        }
    }

    /// Hands out the only access; `None` the second time.
    ///
    /// Meant for initialisation, before interrupts run.
    pub fn take(&'static self) -> Option<Window<T, N>> {
        if self.taken.load(Ordering::Relaxed) {
            return None;
        }
        self.taken.store(true, Ordering::Relaxed);
        Some(Window { shared: self })
    }
}

/// The one access to a [`Shared`] array.
pub struct Window<T: 'static, const N: usize> {
    shared: &'static Shared<T, N>,
}

impl<T: Copy + Send, const N: usize> Window<T, N> {
    /// The address that the DMA controller is given.
    pub fn address(&self) -> u32 {
        self.shared.cells.get() as usize as u32
    }

    /// Elements in the array; fits the 16-bit DMA counters.
    pub const fn len(&self) -> u16 {
        N as u16
    }

    /// Whether the array has no element.
    pub const fn is_empty(&self) -> bool {
        N == 0
    }

    /// Element `index` as it is now, `None` past the end.
    #[inline]
    pub fn read(&self, index: usize) -> Option<T> {
        if index >= N {
            return None;
        }
        let first = self.shared.cells.get().cast::<T>();
        // SAFETY: in bounds; volatile, because the DMA controller may write it.
        Some(unsafe { first.add(index).read_volatile() })
    }

    /// Replaces element `index`; past the end nothing happens.
    ///
    /// The owner must make sure that the DMA controller is not reading it.
    #[inline]
    pub fn write(&mut self, index: usize, value: T) {
        if index < N {
            let first = self.shared.cells.get().cast::<T>();
            // SAFETY: in bounds; volatile, because the DMA controller may read it.
            unsafe { first.add(index).write_volatile(value) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Shared;

    #[test]
    fn a_window_is_handed_out_once_and_stays_in_bounds() {
        static MEMORY: Shared<u16, 3> = Shared::new(7);
        let mut window = MEMORY.take().unwrap();
        assert!(MEMORY.take().is_none());
        window.write(2, 9);
        window.write(3, 1);
        assert_eq!(
            (window.read(1), window.read(2), window.read(3)),
            (Some(7), Some(9), None)
        );
    }
}
