//! The interface between the core's bus and the peripherals: handles loads and stores to peripheral
//! addresses.

use crate::clock::Cycles;
use crate::flash::TimedFlash;
use crate::peripheral::{Nothing, Peripherals, lock};
use crate::silicon::registers::Access;
use rsemu::core::error::BusError;
use rsemu::core::space::{AccessConstraints, AccessPurpose, MemAttrs, MemOps, MemResult};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// State shared by the core and the peripherals of one node. A single thread uses all of it. The
/// atomics are there only because the emulator requires `Send` and `Sync`.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) peripherals: Mutex<Peripherals>,
    /// Cycle at which the current instruction began.
    now: AtomicU64,
    /// The cycle from which the run loop must process the peripherals.
    attention: AtomicU64,
    /// Whether an access waits for the bus of the peripheral.
    waits: bool,
    /// Cycles that the core has waited since they were taken.
    stall: AtomicU64,
}

impl Shared {
    pub(crate) fn new(peripherals: Peripherals, waits: bool) -> Self {
        Self {
            waits,
            stall: AtomicU64::new(0),
            peripherals: Mutex::new(peripherals),
            now: AtomicU64::new(0),
            attention: AtomicU64::new(0),
        }
    }

    /// The same state around a copy of the peripherals.
    pub(crate) fn copy(&self, peripherals: Peripherals) -> Self {
        let same = |number: &AtomicU64| AtomicU64::new(number.load(Ordering::Relaxed));
        Self {
            peripherals: Mutex::new(peripherals),
            now: same(&self.now),
            attention: same(&self.attention),
            waits: self.waits,
            stall: same(&self.stall),
        }
    }

    #[inline]
    pub(crate) fn set_now(&self, now: Cycles) {
        self.now.store(now, Ordering::Relaxed);
    }

    #[inline]
    pub(crate) fn attention(&self) -> Cycles {
        self.attention.load(Ordering::Relaxed)
    }

    pub(crate) fn set_attention(&self, at: Cycles) {
        self.attention.store(at, Ordering::Relaxed);
    }

    /// Cycles that the core has waited for buses of peripherals since the last call.
    #[inline]
    pub(crate) fn take_stall(&self) -> Cycles {
        if self.waits {
            self.stall.swap(0, Ordering::Relaxed)
        } else {
            0
        }
    }

    /// A transfer on a peripheral bus begins with its next cycle and takes two of them (RM0390 2.1.9, and
    /// the AMBA APB specification 2.1).
    fn charge(&self, periods: u64) {
        let so_far = self.stall.load(Ordering::Relaxed);
        let now = self.now.load(Ordering::Relaxed) + so_far;
        let wait = now.next_multiple_of(periods) - now + 2 * periods;
        self.stall.store(so_far + wait, Ordering::Relaxed);
    }

    fn access<R>(&self, address: u32, act: impl FnOnce(&mut Peripherals) -> R) -> R {
        let mut peripherals = lock(&self.peripherals);
        if self.waits
            && let Some(periods) = peripherals.bus_periods(address)
        {
            self.charge(periods);
        }
        let seen = peripherals.lines;
        peripherals.catch_up(self.now.load(Ordering::Relaxed));
        let result = act(&mut peripherals);
        let at_once = peripherals.lines != seen || peripherals.wants_attention();
        self.set_attention(if at_once {
            0
        } else {
            self.attention().min(peripherals.next_event())
        });
        result
    }
}

/// A store of some bytes of a word, from byte `lane` on.
fn written(lane: usize, bytes: &[u8]) -> Access {
    let (mut value, mut mask) = ([0; 4], [0; 4]);
    for (at, &byte) in (lane..4).zip(bytes) {
        value[at] = byte;
        mask[at] = 0xFF;
    }
    Access::Write {
        value: u32::from_le_bytes(value),
        mask: u32::from_le_bytes(mask),
    }
}

/// A range of peripheral addresses.
#[derive(Debug)]
pub(crate) struct Window {
    pub(crate) base: u32,
    pub(crate) shared: Arc<Shared>,
}

impl MemOps for Window {
    fn read(&self, offset: u64, dst: &mut [u8], attrs: MemAttrs) -> MemResult {
        if attrs.debug {
            // A debug read must have no side effects, but reading a register may have some.
            return Err(BusError::BadAccess);
        }
        let address = self.base + offset as u32;
        let lane = (address & 3) as usize;
        let word = self.shared.access(address, |peripherals| {
            peripherals.check(address, dst.len(), Access::Read);
            peripherals.read(address & !3)
        });
        let bytes = word.map_err(|Nothing| BusError::Unassigned)?.to_le_bytes();
        let source = bytes
            .get(lane..lane + dst.len())
            .ok_or(BusError::BadAccess)?;
        dst.copy_from_slice(source);
        Ok(())
    }

    fn write(&self, offset: u64, src: &[u8], attrs: MemAttrs) -> MemResult {
        if attrs.debug {
            return Err(BusError::BadAccess);
        }
        let address = self.base + offset as u32;
        let lane = (address & 3) as usize;
        let mut bytes = [0; 4];
        self.shared
            .access(address, |peripherals| {
                peripherals.check(address, src.len(), written(lane, src));
                if lane != 0 {
                    bytes = peripherals.read(address & !3)?.to_le_bytes();
                }
                if let Some(target) = bytes.get_mut(lane..lane + src.len()) {
                    target.copy_from_slice(src);
                }
                peripherals.write(address & !3, u32::from_le_bytes(bytes))
            })
            .map_err(|Nothing| BusError::Unassigned)
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::IO.with_natural_alignment(true)
    }
}

/// The part of the flash that the program can change.
#[derive(Debug)]
pub(crate) struct Changeable {
    /// Offset of its first byte in the flash.
    pub(crate) begin: u32,
    pub(crate) shared: Arc<Shared>,
    /// How long reading takes, if that counts.
    pub(crate) timed: Option<Arc<TimedFlash>>,
}

impl MemOps for Changeable {
    fn read(&self, offset: u64, dst: &mut [u8], attrs: MemAttrs) -> MemResult {
        let offset = self.begin + offset as u32;
        let peripherals = lock(&self.shared.peripherals);
        let source = peripherals.changed_flash(offset, dst.len());
        dst.copy_from_slice(source.ok_or(BusError::BadAccess)?);
        if let Some(timed) = self.timed.as_ref().filter(|_| !attrs.debug) {
            let fetch = attrs.purpose == AccessPurpose::FETCH;
            timed.charge(offset, dst.len() as u32, fetch);
        }
        Ok(())
    }

    fn write(&self, offset: u64, src: &[u8], attrs: MemAttrs) -> MemResult {
        if attrs.debug {
            return Err(BusError::BadAccess);
        }
        let offset = self.begin + offset as u32;
        self.shared
            .access(parts::F446.flash.base + offset, |peripherals| {
                peripherals.store_flash(offset, src);
            });
        Ok(())
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}
