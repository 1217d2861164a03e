//! A GPIO port: rsemu's register model, with external drivers added to its pins.
//!
//! A pin without an external driver follows its pull resistor. Without that it reads low.

use crate::part::Family;
use rsemu::core::device::{Device, ResetKind};
use rsemu::core::space::MemOps;
use rsemu::dev::stm32::gpio::{Gpio, ResetValues, Variant};
use std::sync::Arc;

const MODER: u32 = 0x00;
/// The pull resistors (RM0390 7.3.9, RM0316 11.3.9).
pub(crate) const PUPDR: u32 = 0x0C;
/// The levels of the pins, whatever drives them (RM0390 7.3.10, RM0316 11.3.10).
pub(crate) const IDR: u32 = 0x10;

#[derive(Debug)]
pub(crate) struct Port {
    family: Family,
    index: usize,
    model: Gpio,
    registers: Arc<dyn MemOps>,
    size: u32,
    /// What drives each pin from outside.
    external: [Option<bool>; 16],
}

impl Clone for Port {
    fn clone(&self) -> Self {
        let mut copy = Self::new(self.family, self.index);
        copy.external = self.external;
        super::transfer(&self.model, &copy.model);
        copy.pull();
        copy
    }
}

impl Port {
    /// Port `index` (0 is A) with its reset values (RM0390 7.4, RM0316 11.4).
    pub(crate) fn new(family: Family, index: usize) -> Self {
        let reset = match index {
            0 => ResetValues {
                moder: 0xA800_0000,
                ospeedr: 0x0C00_0000,
                pupdr: 0x6400_0000,
            },
            1 => ResetValues {
                moder: 0x0000_0280,
                ospeedr: 0x0000_00C0,
                pupdr: 0x0000_0100,
            },
            _ => ResetValues {
                moder: 0,
                ospeedr: 0,
                pupdr: 0,
            },
        };
        // The F303 has the bit reset register BRR behind AFRH, as the model's newer
        // register file does; what follows BRR there is cut off by the size.
        let (variant, size) = match family {
            Family::F4 => (Variant::F4, 0x28),
            Family::F3 => (Variant::U5, 0x2C),
        };
        let model = Gpio::with_variant(reset, variant);
        let registers = super::registers_of(&model);
        let mut port = Self {
            family,
            index,
            model,
            registers,
            size,
            external: [None; 16],
        };
        port.pull();
        port
    }

    pub(crate) fn reset(&mut self) {
        self.model.reset(ResetKind::Cold);
        self.pull();
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        if offset >= self.size {
            return None;
        }
        super::read_word(&*self.registers, offset)
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        if offset < self.size {
            super::write_word(&*self.registers, offset, value);
            if offset == PUPDR {
                self.pull();
            }
        }
    }

    /// Levels of the sixteen pins.
    pub(crate) fn levels(&self) -> u32 {
        self.model.pin_levels()
    }

    /// What drives a pin from outside.
    pub(crate) fn external(&self, pin: u8) -> Option<bool> {
        self.external.get(usize::from(pin)).copied().flatten()
    }

    /// Drives a pin from outside, or stops driving it (`None`).
    pub(crate) fn drive(&mut self, pin: u8, level: Option<bool>) {
        if let Some(external) = self.external.get_mut(usize::from(pin)) {
            *external = level;
            self.pull();
        }
    }

    fn pull(&mut self) {
        for pin in 0..16 {
            let level = self.level_from_outside(pin);
            self.model.set_external(u32::from(pin), level);
            // A peripheral's input, too, has the level that comes from outside. What a peripheral sends is modelled
            // elsewhere.
            let driven = self.external(pin).unwrap_or(false);
            self.model.set_alternate(u32::from(pin), driven);
        }
    }

    /// The level of a pin that the part does not drive.
    pub(crate) fn level_from_outside(&self, pin: u8) -> bool {
        let pulled_up = || self.read(PUPDR).unwrap_or(0) >> (2 * pin) & 3 == 1;
        self.external(pin).unwrap_or_else(pulled_up)
    }

    /// True if the pin is assigned to alternate function `function`.
    pub(crate) fn routed(&self, pin: u8, function: u8) -> bool {
        let mode = self.read(MODER).unwrap_or(0) >> (2 * u32::from(pin)) & 3;
        mode == 2 && self.model.alternate_function(u32::from(pin)) == function
    }

    /// The pins that are outputs, one bit each.
    pub(crate) fn outputs(&self) -> u32 {
        let modes = self.read(MODER).unwrap_or(0);
        (0..16)
            .filter(|pin| modes >> (2 * pin) & 3 == 1)
            .fold(0, |outputs, pin| outputs | 1 << pin)
    }
}

#[cfg(test)]
mod tests {
    use super::Port;
    use crate::part::Family;

    #[test]
    fn an_open_input_follows_its_pull_resistor_and_a_driven_one_its_driver() {
        let mut port = Port::new(Family::F4, 2);
        port.write(0x0C, 1 << 10);
        assert_eq!(port.read(0x10), Some(1 << 5));
        port.drive(5, Some(false));
        assert_eq!(port.read(0x10), Some(0));
        port.drive(5, None);
        port.write(0x0C, 0);
        assert_eq!(port.read(0x10), Some(0));
    }

    #[test]
    fn a_peripherals_input_reads_as_the_level_from_outside() {
        let mut port = Port::new(Family::F3, 1);
        port.write(0x00, 2 << 8);
        port.drive(4, Some(true));
        assert_eq!(port.read(0x10).unwrap() >> 4 & 1, 1);
        port.drive(4, Some(false));
        assert_eq!(port.read(0x10).unwrap() >> 4 & 1, 0);
    }

    #[test]
    fn only_the_f303_has_a_bit_reset_register() {
        let mut port = Port::new(Family::F3, 1);
        port.write(0x00, 1 << 6);
        port.write(0x18, 1 << 3);
        assert_eq!(port.levels() & 1 << 3, 1 << 3);
        port.write(0x28, 1 << 3);
        assert_eq!(port.levels() & 1 << 3, 0);
        assert_eq!(Port::new(Family::F4, 1).read(0x28), None);
        assert_eq!(port.read(0x2C), None);
    }

    #[test]
    fn a_pin_is_routed_by_its_mode_and_its_function() {
        let mut port = Port::new(Family::F4, 1);
        port.write(0x24, 9 << 4);
        assert!(!port.routed(9, 9));
        port.write(0x00, 2 << 18);
        assert!(port.routed(9, 9));
        assert!(!port.routed(9, 7));
    }
}
