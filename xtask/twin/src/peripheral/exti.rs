//! The external interrupt controller of the F446 (RM0390 10.3) with the multiplexers of SYSCFG in front
//! of its lines (8.2.3): detection of edges, interrupts, software triggers. Events to wake the core up
//! are not modelled, nor are the interrupts of lines 5 to 15.

/// The line of the voltage detector (RM0390 10.2.5).
pub(crate) const VOLTAGE: u32 = 16;
/// Lines that are wired to pins of the same number.
const PINS: u32 = 16;

#[derive(Clone, Debug, Default)]
pub(crate) struct Exti {
    interrupts: u32,
    events: u32,
    rising: u32,
    falling: u32,
    pending: u32,
    /// Levels of the lines.
    levels: u32,
    /// SYSCFG_EXTICR1 to 4: four bits for the port of each line (RM0390 8.2.3).
    ports: [u32; 4],
}

impl Exti {
    /// Resets the registers; the lines keep their levels.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            levels: self.levels,
            ..Self::default()
        };
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x00 => Some(self.interrupts),
            0x04 => Some(self.events),
            0x08 => Some(self.rising),
            0x0C => Some(self.falling),
            // A bit of SWIER is cleared together with that of PR. It shows nothing else here.
            0x10 => Some(0),
            0x14 => Some(self.pending),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0x00 => self.interrupts = value,
            0x04 => self.events = value,
            0x08 => self.rising = value,
            0x0C => self.falling = value,
            0x10 => self.pending |= value & self.interrupts,
            0x14 => self.pending &= !value,
            _ => {}
        }
    }

    /// Reads a register of SYSCFG.
    pub(crate) fn read_ports(&self, offset: u32) -> Option<u32> {
        match offset {
            0x08..=0x14 => self.ports.get((offset / 4 - 2) as usize).copied(),
            _ => None,
        }
    }

    /// Writes a register of SYSCFG. The levels that the lines have by that must be driven behind it.
    pub(crate) fn write_ports(&mut self, offset: u32, value: u32) {
        if let 0x08..=0x14 = offset
            && let Some(ports) = self.ports.get_mut((offset / 4 - 2) as usize)
        {
            *ports = value & 0xFFFF;
        }
    }

    /// SYSCFG is reset.
    pub(crate) fn reset_ports(&mut self) {
        self.ports = [0; 4];
    }

    /// The pins of a port have these levels from now on.
    pub(crate) fn drive_port(&mut self, port: usize, levels: u32) {
        for line in 0..PINS {
            let wired = self.ports[(line / 4) as usize] >> (line % 4 * 4) & 0xF;
            if wired as usize == port {
                self.drive(line, levels >> line & 1 != 0);
            }
        }
    }

    /// A line has this level from now on.
    pub(crate) fn drive(&mut self, line: u32, high: bool) {
        let bit = 1 << line;
        let before = self.levels & bit != 0;
        let edge = match (before, high) {
            (false, true) => self.rising,
            (true, false) => self.falling,
            _ => 0,
        };
        self.pending |= edge & bit;
        self.levels = self.levels & !bit | u32::from(high) << line;
    }

    /// Level of a line's interrupt.
    pub(crate) fn interrupt(&self, line: u32) -> bool {
        self.pending & self.interrupts & 1 << line != 0
    }
}

#[cfg(test)]
mod tests {
    use super::{Exti, VOLTAGE};

    #[test]
    fn only_the_chosen_edge_of_an_enabled_line_interrupts() {
        let mut exti = Exti::default();
        exti.write(0x08, 1 << VOLTAGE);
        exti.drive(VOLTAGE, true);
        assert_eq!(exti.read(0x14), Some(1 << VOLTAGE));
        assert!(!exti.interrupt(VOLTAGE));
        exti.write(0x00, 1 << VOLTAGE);
        assert!(exti.interrupt(VOLTAGE));
        exti.write(0x14, 1 << VOLTAGE);
        assert!(!exti.interrupt(VOLTAGE));
        exti.drive(VOLTAGE, false);
        assert!(!exti.interrupt(VOLTAGE));
        exti.write(0x10, 1 << VOLTAGE);
        assert!(exti.interrupt(VOLTAGE));
    }

    #[test]
    fn a_level_that_was_there_before_is_no_edge() {
        let mut exti = Exti::default();
        exti.drive(VOLTAGE, true);
        exti.write(0x00, 1 << VOLTAGE);
        exti.write(0x08, 1 << VOLTAGE);
        exti.drive(VOLTAGE, true);
        assert!(!exti.interrupt(VOLTAGE));
        exti.reset();
        assert_eq!(exti.read(0x08), Some(0));
    }
}
