//! CAN sleds: the boards of the vehicles.

use core::fmt;

use crate::part::{F303, F446, Memory, Part};

/// A pin: port letter and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pin {
    /// `'A'` to `'H'`.
    pub port: char,
    /// 0 to 15.
    pub number: u8,
}

impl Pin {
    /// The pin `number` of port `port`.
    #[must_use]
    pub const fn new(port: char, number: u8) -> Self {
        Self { port, number }
    }

    /// The port counted from A as 0.
    #[must_use]
    pub const fn port_index(self) -> usize {
        (self.port as usize).wrapping_sub('A' as usize)
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", self.port, self.number)
    }
}

/// What a board uses a pin for. Peripherals have the numbers of the manuals, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Transmit line of a USART.
    UsartTransmit(u8),
    /// Receive line of a USART.
    UsartReceive(u8),
    /// Transmit line of a CAN controller.
    CanTransmit(u8),
    /// Receive line of a CAN controller.
    CanReceive(u8),
    /// Analogue input of ADC1: its channel.
    Analog(u8),
    /// Digital input.
    Input,
    /// Digital output.
    Output,
    /// Output of a channel of a timer.
    TimerOutput(TimerOutput),
}

/// An output of a channel of a timer. Timers and channels are counted from 1, as in the manuals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TimerOutput {
    /// The timer.
    pub timer: u8,
    /// Its channel.
    pub channel: u8,
    /// True for the complementary output (CHxN in the manuals).
    pub complementary: bool,
}

/// One line of a connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Signal {
    /// Name within the connector.
    pub name: &'static str,
    /// The pin it is wired to.
    pub pin: Pin,
    /// What the pin is used for.
    pub role: Role,
    /// Alternate function that connects the peripheral to the pin; 0 for inputs and
    /// outputs (data sheets, tables of alternate functions).
    pub alternate: u8,
}

/// A place of a board that a device is wired to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Connector {
    /// Name within the board.
    pub name: &'static str,
    /// Its lines.
    pub signals: &'static [Signal],
}

impl Connector {
    /// The line with this name.
    #[must_use]
    pub fn signal(&self, name: &str) -> Option<&'static Signal> {
        self.signals.iter().find(|signal| signal.name == name)
    }

    /// The USART behind the connector, from 1.
    #[must_use]
    pub fn usart(&self) -> Option<u8> {
        self.signals.iter().find_map(|signal| match signal.role {
            Role::UsartTransmit(usart) | Role::UsartReceive(usart) => Some(usart),
            _ => None,
        })
    }

    /// Whether it has analogue inputs. A sled has one converter, one DMA channel and one timer for
    /// them, so a node can use only one of its connectors with analogue inputs.
    #[must_use]
    pub fn uses_converter(&self) -> bool {
        let mut signals = self.signals.iter();
        signals.any(|signal| matches!(signal.role, Role::Analog(_)))
    }
}

/// The lines of a USART that a board wires.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UsartPins {
    /// Transmit line.
    pub transmit: Option<&'static Signal>,
    /// Receive line.
    pub receive: Option<&'static Signal>,
}

/// Clock frequencies of a running board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Clocks {
    /// Core and AHB, Hz.
    pub core: u32,
    /// Peripheral bus 1 (CAN, USART2, USART3), Hz.
    pub apb1: u32,
    /// Peripheral bus 2 (USART1), Hz.
    pub apb2: u32,
    /// Ticks of the time base (TIM2) per microsecond.
    pub ticks_per_us: u32,
}

impl Clocks {
    /// Clock of the timers on APB1, Hz: twice the bus clock, because both boards divide it
    /// (RM0390 6.2, RM0316 9.2.9).
    #[must_use]
    pub const fn apb1_timers(&self) -> u32 {
        2 * self.apb1
    }

    /// Prescaler of the time base.
    #[must_use]
    pub const fn time_base_prescaler(&self) -> u32 {
        self.apb1_timers() / (self.ticks_per_us * 1_000_000)
    }
}

/// The wires of a bus guardian to one node: its TX line, and the gate between it and the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tap {
    /// Input: TX of the node's CAN controller, in front of the gate; low is dominant.
    pub line: Pin,
    /// Output to one input of the OR gate; high closes it. A pull-down resistor opens the gate while the
    /// pin is not driven.
    pub gate: Pin,
}

/// How much of its board an image may use, in bytes. The budgets are smaller than the
/// memories, so that a growing image is noticed before a memory is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Budget {
    /// Code and constants.
    pub flash: u32,
    /// Static variables.
    pub statics: u32,
    /// Smallest stack.
    pub stack: u32,
}

/// A board: a Nucleo board on a CAN sled (thesis 5.2.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Sled {
    /// Name in manifests and tables; the firmware's feature of this name selects the board.
    pub name: &'static str,
    /// Name of the board's crate.
    pub package: &'static str,
    /// The Nucleo board.
    pub title: &'static str,
    /// The microcontroller.
    pub part: &'static Part,
    /// Clock that the debugger of the Nucleo board feeds in, Hz.
    pub external_hz: u32,
    /// Clocks made from the external clock.
    pub external: Clocks,
    /// Clocks made from the internal oscillator, when the external clock is missing.
    pub internal: Clocks,
    /// Bit rates of the CAN port, bit/s, of which a network has one. The board's bit timing makes
    /// each of them exactly from all its clocks.
    pub bit_rates: &'static [u32],
    /// The stack. Below it lies no memory: an overflow is a bus fault at once, and never a
    /// silent change of a variable.
    pub stack: Memory,
    /// The last erase unit of the flash, which is for the key of the network and holds no part of an
    /// image: so a new image leaves the key, and a new key the image.
    pub secret: Memory,
    /// The two erase units below that, which are for missions and hold no part of an image; `None` on a board that
    /// has no room for them.
    pub mission: Option<Memory>,
    /// The two erase units below the key, in which a node counts its starts; `None` on a board that has no room for
    /// them.
    pub starts: Option<Memory>,
    /// What an image may use.
    pub budget: Budget,
    /// Ticks of the time base from an interrupt of the bus to the time stamp that its task
    /// takes: exception entry and the first instructions of the task.
    pub stamp_ticks: u32,
    /// Ticks of the time base by which a transmission begins before its time mark: the time
    /// of the window task from the compare event to the transmit request, and half a bit.
    ///
    /// All bits on the bus follow the edges of the reference message, and a time mark lies a
    /// whole number of bits behind its start of frame. A request within the last bit before
    /// the mark starts the frame on the mark; a request just after the mark starts it one bit
    /// late.
    pub transmit_lead_ticks: u32,
    /// Everything that the board is wired to.
    pub connectors: &'static [Connector],
    /// The wires to the nodes that it can guard as a bus guardian, which has nothing else at these pins;
    /// none if it cannot be one.
    pub taps: &'static [Tap],
}

const KIB: u32 = 1024;

/// Bit rate of the sleds, bit/s (thesis 6.2.3.1).
const BIT_RATES: &[u32] = &[125_000, 250_000, 500_000];

const fn signal(name: &'static str, port: char, number: u8, role: Role, alternate: u8) -> Signal {
    Signal {
        name,
        pin: Pin::new(port, number),
        role,
        alternate,
    }
}

/// An output of TIM1.
const fn timer_1(channel: u8, complementary: bool) -> Role {
    Role::TimerOutput(TimerOutput {
        timer: 1,
        channel,
        complementary,
    })
}

const fn tap(line: (char, u8), gate: (char, u8)) -> Tap {
    Tap {
        line: Pin::new(line.0, line.1),
        gate: Pin::new(gate.0, gate.1),
    }
}

/// The Nucleo-F446RE on a CAN sled.
///
/// - Clocks: 8 MHz / 4 x 180 / 2 = 180 MHz; from the 16 MHz HSI, divided by 8, the same.
/// - Stamp: some 40 cycles of 180 MHz, or 0.2 us.
/// - Transmit lead: the window task takes some 3 us, half a bit is 2 us: 5 us.
pub static SLED_F446: Sled = Sled {
    name: "f446",
    package: "sled-f446",
    title: "Nucleo-F446RE",
    part: &F446,
    external_hz: 8_000_000,
    external: CLOCKS_F446,
    internal: CLOCKS_F446,
    bit_rates: BIT_RATES,
    stack: Memory {
        name: "STACK",
        base: 0x2000_0000,
        size: 16 * KIB,
        dma: true,
    },
    secret: Memory {
        name: "SECRET",
        base: 0x0806_0000,
        size: 128 * KIB,
        dma: true,
    },
    mission: Some(Memory {
        name: "MISSION",
        base: 0x0802_0000,
        size: 256 * KIB,
        dma: true,
    }),
    starts: None,
    budget: Budget {
        flash: 128 * KIB,
        statics: 32 * KIB,
        stack: 8 * KIB,
    },
    stamp_ticks: 4,
    transmit_lead_ticks: 90,
    connectors: &[
        Connector {
            name: "can",
            signals: &[
                signal("tx", 'B', 9, Role::CanTransmit(1), 9),
                signal("rx", 'B', 8, Role::CanReceive(1), 9),
            ],
        },
        Connector {
            name: "console",
            signals: &[
                signal("tx", 'A', 2, Role::UsartTransmit(2), 7),
                signal("rx", 'A', 3, Role::UsartReceive(2), 7),
            ],
        },
        Connector {
            name: "led",
            signals: &[signal("led", 'A', 5, Role::Output, 0)],
        },
        Connector {
            name: "receiver",
            signals: &[
                signal("tx", 'A', 9, Role::UsartTransmit(1), 7),
                signal("rx", 'A', 10, Role::UsartReceive(1), 7),
            ],
        },
        Connector {
            name: "display",
            signals: &[
                signal("tx", 'C', 10, Role::UsartTransmit(3), 7),
                signal("rx", 'C', 11, Role::UsartReceive(3), 7),
            ],
        },
        Connector {
            name: "joystick",
            signals: &[
                signal("x", 'A', 0, Role::Analog(0), 0),
                signal("y", 'A', 1, Role::Analog(1), 0),
            ],
        },
        Connector {
            name: "inputs",
            signals: &[
                signal("a", 'C', 0, Role::Input, 0),
                signal("b", 'C', 1, Role::Input, 0),
                signal("c", 'C', 2, Role::Input, 0),
                signal("d", 'C', 3, Role::Input, 0),
                signal("joystick-switch", 'C', 4, Role::Input, 0),
                signal("stop-loop", 'C', 5, Role::Input, 0),
            ],
        },
    ],
    taps: &[
        tap(('C', 0), ('C', 6)),
        tap(('C', 1), ('C', 7)),
        tap(('C', 2), ('C', 8)),
        tap(('C', 3), ('C', 9)),
    ],
};

const CLOCKS_F446: Clocks = Clocks {
    core: 180_000_000,
    apb1: 45_000_000,
    apb2: 90_000_000,
    ticks_per_us: 18,
};

/// The Nucleo-F303K8 on a CAN sled.
///
/// - Clocks: 8 MHz x 9 = 72 MHz; from the 8 MHz HSI, divided by 2, x 16 = 64 MHz.
/// - The stack fills the core-coupled memory.
/// - Stamp: some 45 cycles of 72 MHz, or 0.6 us.
/// - Transmit lead: the window task takes some 7 us, half a bit is 2 us: 9 us.
/// - Left free: PA4, PB1 and PF1. PA5 and PA6 are joined to PB7 and PB6 by solder bridges of the
///   Nucleo-32 (SB18 and SB16, UM1956), so none of the four is used.
pub static SLED_F303: Sled = Sled {
    name: "f303",
    package: "sled-f303",
    title: "Nucleo-F303K8",
    part: &F303,
    external_hz: 8_000_000,
    external: Clocks {
        core: 72_000_000,
        apb1: 36_000_000,
        apb2: 72_000_000,
        ticks_per_us: 18,
    },
    internal: Clocks {
        core: 64_000_000,
        apb1: 32_000_000,
        apb2: 64_000_000,
        ticks_per_us: 16,
    },
    bit_rates: BIT_RATES,
    stack: Memory {
        name: "STACK",
        base: 0x1000_0000,
        size: 4 * KIB,
        dma: false,
    },
    secret: Memory {
        name: "SECRET",
        base: 0x0800_F800,
        size: 2 * KIB,
        dma: true,
    },
    mission: None,
    starts: Some(Memory {
        name: "STARTS",
        base: 0x0800_E800,
        size: 4 * KIB,
        dma: true,
    }),
    budget: Budget {
        flash: 58 * KIB,
        statics: 8 * KIB,
        stack: 2 * KIB,
    },
    stamp_ticks: 11,
    transmit_lead_ticks: 162,
    connectors: &[
        Connector {
            name: "can",
            signals: &[
                signal("tx", 'A', 12, Role::CanTransmit(1), 9),
                signal("rx", 'A', 11, Role::CanReceive(1), 9),
            ],
        },
        Connector {
            name: "console",
            signals: &[
                signal("tx", 'A', 2, Role::UsartTransmit(2), 7),
                signal("rx", 'A', 15, Role::UsartReceive(2), 7),
            ],
        },
        Connector {
            name: "led",
            signals: &[signal("led", 'B', 3, Role::Output, 0)],
        },
        Connector {
            name: "motor",
            signals: &[
                signal("tx", 'A', 9, Role::UsartTransmit(1), 7),
                signal("relay", 'A', 8, Role::Output, 0),
                signal("sense", 'B', 0, Role::Input, 0),
            ],
        },
        Connector {
            name: "pot",
            signals: &[signal("wiper", 'A', 0, Role::Analog(1), 0)],
        },
        Connector {
            name: "distances",
            signals: &[
                signal("left", 'A', 1, Role::Analog(2), 0),
                signal("right", 'A', 3, Role::Analog(4), 0),
            ],
        },
        Connector {
            name: "servos",
            signals: &[
                signal("left", 'A', 7, timer_1(1, true), 6),
                signal("right", 'A', 10, timer_1(3, false), 6),
            ],
        },
        Connector {
            name: "remote",
            signals: &[
                signal("run", 'B', 5, Role::Input, 0),
                signal("stop", 'B', 4, Role::Input, 0),
            ],
        },
    ],
    // A guardian has neither servos nor a remote control.
    taps: &[tap(('B', 4), ('A', 7))],
};

impl Sled {
    /// The Nucleo-F446RE on a CAN sled.
    pub const F446: &'static Self = &SLED_F446;
    /// The Nucleo-F303K8 on a CAN sled.
    pub const F303: &'static Self = &SLED_F303;
    /// All boards.
    pub const ALL: [&'static Self; 2] = [Self::F446, Self::F303];

    /// Whether the board has this bit rate, bit/s.
    #[must_use]
    pub const fn has_bit_rate(&self, bit_rate: u32) -> bool {
        let mut index = 0;
        while index < self.bit_rates.len() {
            if self.bit_rates[index] == bit_rate {
                return true;
            }
            index += 1;
        }
        false
    }

    /// The board with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        Self::ALL.into_iter().find(|sled| sled.name == name)
    }

    /// The board that carries `part`.
    #[must_use]
    pub fn carrying(part: &Part) -> Option<&'static Self> {
        Self::ALL.into_iter().find(|sled| sled.part == part)
    }

    /// The connector with this name.
    #[must_use]
    pub fn connector(&self, name: &str) -> Option<&'static Connector> {
        self.connectors.iter().find(|place| place.name == name)
    }

    /// The pin of line `signal` of `connector`, for use in constants.
    #[must_use]
    pub const fn pin(&self, connector: &str, signal: &str) -> Option<Pin> {
        let mut place = 0;
        while place < self.connectors.len() {
            let of = &self.connectors[place];
            let mut line = 0;
            while line < of.signals.len() {
                if same(of.name, connector) && same(of.signals[line].name, signal) {
                    return Some(of.signals[line].pin);
                }
                line += 1;
            }
            place += 1;
        }
        None
    }

    /// All lines of all connectors.
    pub fn signals(&self) -> impl Iterator<Item = &'static Signal> + use<> {
        self.connectors.iter().flat_map(|place| place.signals)
    }

    /// The line whose pin has this role.
    #[must_use]
    pub fn wired_as(&self, role: Role) -> Option<&'static Signal> {
        self.signals().find(|signal| signal.role == role)
    }

    /// The lines of a USART, counted from 1.
    #[must_use]
    pub fn usart_pins(&self, usart: u8) -> UsartPins {
        UsartPins {
            transmit: self.wired_as(Role::UsartTransmit(usart)),
            receive: self.wired_as(Role::UsartReceive(usart)),
        }
    }

    /// The transmit lead in picoseconds on the clocks made from the external clock.
    #[must_use]
    pub const fn transmit_lead_ps(&self) -> u64 {
        self.transmit_lead_ticks as u64 * 1_000_000 / self.external.ticks_per_us as u64
    }

    /// The memory that variables are placed in: the first RAM of the part without the stack.
    #[must_use]
    pub const fn variables(&self) -> Memory {
        let ram = self.part.ram[0];
        if ram.holds(self.stack.base, self.stack.size) {
            Memory {
                base: self.stack.end(),
                size: ram.end() - self.stack.end(),
                ..ram
            }
        } else {
            ram
        }
    }

    /// The part of the flash that images are placed in: all below the missions or the starts, and the key.
    #[must_use]
    pub const fn program(&self) -> Memory {
        let flash = self.part.flash;
        let end = match (&self.mission, &self.starts) {
            (Some(below), _) | (None, Some(below)) => below.base,
            (None, None) => self.secret.base,
        };
        Memory {
            size: end - flash.base,
            ..flash
        }
    }

    /// The memory layout for the linker, `memory.x`.
    #[must_use]
    pub const fn linker_script(&self) -> LinkerScript<'_> {
        LinkerScript(self)
    }
}

/// Writes a board's memory layout in the language of the linker.
#[derive(Clone, Copy, Debug)]
pub struct LinkerScript<'a>(&'a Sled);

impl fmt::Display for LinkerScript<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "MEMORY\n{{")?;
        for memory in [self.0.program(), self.0.stack, self.0.variables()] {
            writeln!(
                f,
                "  {:<5} : ORIGIN = {:#010x}, LENGTH = {}",
                memory.name, memory.base, memory.size
            )?;
        }
        writeln!(f, "}}\n")?;
        writeln!(f, "_stack_start = ORIGIN(STACK) + LENGTH(STACK);")?;
        writeln!(f, "_stack_end = ORIGIN(STACK);")?;
        writeln!(f, "_ram_start = ORIGIN(RAM);")
    }
}

/// String equality for constants.
const fn same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    if a.len() != b.len() {
        return false;
    }
    let mut index = 0;
    while index < a.len() {
        if a[index] != b[index] {
            return false;
        }
        index += 1;
    }
    true
}

/// True if the frequencies are within what the part allows and the time base counts whole
/// ticks.
const fn sound(part: &Part, clocks: &Clocks) -> bool {
    clocks.core <= part.limits.core
        && clocks.apb1 <= part.limits.apb1
        && clocks.apb2 <= part.limits.apb2
        && part.flash_access.wait_states(clocks.core).is_some()
        && clocks.time_base_prescaler() * clocks.ticks_per_us * 1_000_000 == clocks.apb1_timers()
}

/// True if the stack begins at the lower end of a memory of the part, so that an overflow
/// leaves memory.
const fn stack_is_guarded(sled: &Sled) -> bool {
    let mut index = 0;
    while index < sled.part.ram.len() {
        let ram = &sled.part.ram[index];
        if ram.base == sled.stack.base && sled.stack.size <= ram.size && ram.dma == sled.stack.dma {
            return true;
        }
        index += 1;
    }
    false
}

const _: () = {
    let mut index = 0;
    while index < Sled::ALL.len() {
        let sled = Sled::ALL[index];
        assert!(sound(sled.part, &sled.external) && sound(sled.part, &sled.internal));
        assert!(
            sled.part.flash.contains(sled.secret.base)
                && sled.secret.end() == sled.part.flash.end()
        );
        if let Some(mission) = &sled.mission {
            assert!(mission.end() == sled.secret.base && sled.starts.is_none());
        }
        if let Some(starts) = &sled.starts {
            assert!(starts.end() == sled.secret.base);
        }
        assert!(stack_is_guarded(sled) && sled.budget.stack <= sled.stack.size);
        index += 1;
    }
};

#[cfg(test)]
mod tests {
    extern crate std;
    use super::{Role, Sled};
    use crate::Part;
    use std::collections::BTreeSet;
    use std::string::ToString;

    #[test]
    fn boards_and_parts_are_found_by_name() {
        for sled in Sled::ALL {
            assert_eq!(Sled::named(sled.name), Some(sled));
            assert_eq!(Sled::carrying(sled.part), Some(sled));
            assert_eq!(Part::named(sled.part.name), Some(sled.part));
        }
        assert_eq!(Sled::named("sled-f446"), None);
    }

    #[test]
    fn no_pin_and_no_role_of_a_peripheral_is_used_twice() {
        for sled in Sled::ALL {
            let pins: BTreeSet<_> = sled.signals().map(|signal| signal.pin).collect();
            assert_eq!(pins.len(), sled.signals().count(), "{}", sled.name);
            for signal in sled.signals() {
                let connector = sled.connectors.iter().find(|c| c.signals.contains(signal));
                let pin = sled.pin(connector.unwrap().name, signal.name);
                assert_eq!(pin, Some(signal.pin));
                if !matches!(signal.role, Role::Input | Role::Output) {
                    assert_eq!(sled.wired_as(signal.role), Some(signal));
                }
            }
        }
    }

    #[test]
    fn no_pin_is_a_tap_twice() {
        for sled in Sled::ALL {
            let pins: BTreeSet<_> = sled
                .taps
                .iter()
                .flat_map(|tap| [tap.line, tap.gate])
                .collect();
            assert_eq!(pins.len(), 2 * sled.taps.len(), "{}", sled.name);
            // What every node uses is no tap.
            let common = ["can", "console", "led"].map(|name| sled.connector(name).unwrap());
            for signal in common.into_iter().flat_map(|place| place.signals) {
                assert!(!pins.contains(&signal.pin), "{}", signal.name);
            }
        }
    }

    #[test]
    fn a_node_of_the_f303_sled_can_use_one_of_two_connectors_with_analogue_inputs() {
        let analogue = |sled: &'static Sled| -> std::vec::Vec<&str> {
            let connectors = sled.connectors.iter();
            connectors
                .filter(|place| place.uses_converter())
                .map(|place| place.name)
                .collect()
        };
        assert_eq!(analogue(Sled::F303), ["pot", "distances"]);
        assert_eq!(analogue(Sled::F446), ["joystick"]);
    }

    #[test]
    fn the_flash_waits_as_long_as_the_manuals_say() {
        let states = |part: &Part, hz| part.flash_access.wait_states(hz);
        assert_eq!(states(Part::F446, 180_000_000), Some(5));
        assert_eq!(states(Part::F446, 16_000_000), Some(0));
        assert_eq!(states(Part::F303, 72_000_000), Some(2));
        assert_eq!(states(Part::F303, 64_000_000), Some(2));
        assert_eq!(states(Part::F303, 72_000_001), None);
    }

    #[test]
    fn the_linker_gets_a_stack_with_no_memory_below() {
        assert_eq!(
            Sled::F446.linker_script().to_string(),
            "MEMORY\n{\n  \
             FLASH : ORIGIN = 0x08000000, LENGTH = 131072\n  \
             STACK : ORIGIN = 0x20000000, LENGTH = 16384\n  \
             RAM   : ORIGIN = 0x20004000, LENGTH = 114688\n}\n\n\
             _stack_start = ORIGIN(STACK) + LENGTH(STACK);\n_stack_end = ORIGIN(STACK);\n\
             _ram_start = ORIGIN(RAM);\n"
        );
        let f303 = Sled::F303.linker_script().to_string();
        assert!(
            f303.contains("STACK : ORIGIN = 0x10000000, LENGTH = 4096"),
            "{f303}"
        );
        assert!(
            f303.contains("RAM   : ORIGIN = 0x20000000, LENGTH = 12288"),
            "{f303}"
        );
    }
}
