//! What distinguishes one microcontroller from the other: memories, where each
//! peripheral answers, which clock gate it hangs on, which interrupt and which DMA
//! request line is its own.
//!
//! STM32F446RE: RM0390 rev 6, memory map 2.2, vector table 10.1.3, DMA requests 9.3.4.
//! STM32F303K8: RM0316 rev 8, memory map 3.2, vector table 14.1.3, DMA requests 13.4.7.

/// One of the two microcontrollers of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Part {
    /// STM32F446RE: 512 KiB flash, 128 KiB RAM, up to 180 MHz.
    F446,
    /// STM32F303K8: 64 KiB flash, 12 KiB RAM and 4 KiB core-coupled memory, 72 MHz.
    F303,
}

/// A stretch of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// First address.
    pub base: u32,
    /// Size in bytes.
    pub size: u32,
    /// Whether the DMA controllers reach it.
    pub dma: bool,
}

impl Memory {
    /// Whether `address` lies inside.
    #[must_use]
    pub const fn contains(self, address: u32) -> bool {
        address >= self.base && address - self.base < self.size
    }
}

/// A peripheral that is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Block {
    Rcc,
    Flash,
    Pwr,
    Iwdg,
    Dbgmcu,
    /// Port 0 is A.
    Gpio(usize),
    /// Index into [`TIMERS`].
    Tim(usize),
    /// 0 is USART1.
    Usart(usize),
    /// 0 is DMA1.
    Dma(usize),
    Adc,
    Can,
}

/// Where a peripheral answers, and the clock gate in front of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    pub base: u32,
    pub size: u32,
    pub block: Block,
    /// Offset of the enable register in RCC, offset of the reset register, bit.
    pub gate: Option<(u32, u32, u32)>,
}

/// The timers that are modelled, in the order of their index.
pub(crate) const TIMERS: [u8; 3] = [2, 3, 4];
/// Index of TIM3 in [`TIMERS`], whose TRGO starts the ADC scans.
pub(crate) const TIM3: usize = 1;

const fn slot(base: u32, size: u32, block: Block, gate: Option<(u32, u32, u32)>) -> Slot {
    Slot {
        base,
        size,
        block,
        gate,
    }
}

const fn f4_ahb1(bit: u32) -> Option<(u32, u32, u32)> {
    Some((0x30, 0x10, bit))
}
const fn f4_apb1(bit: u32) -> Option<(u32, u32, u32)> {
    Some((0x40, 0x20, bit))
}
const fn f4_apb2(bit: u32) -> Option<(u32, u32, u32)> {
    Some((0x44, 0x24, bit))
}
const fn f3_ahb(bit: u32) -> Option<(u32, u32, u32)> {
    Some((0x14, 0x28, bit))
}
const fn f3_apb1(bit: u32) -> Option<(u32, u32, u32)> {
    Some((0x1C, 0x10, bit))
}
const fn f3_apb2(bit: u32) -> Option<(u32, u32, u32)> {
    Some((0x18, 0x0C, bit))
}

/// RM0390 2.2.2 (addresses), 6.3.5-6.3.14 (gates).
static F446_SLOTS: [Slot; 23] = [
    slot(0x4000_0000, 0x400, Block::Tim(0), f4_apb1(0)),
    slot(0x4000_0400, 0x400, Block::Tim(1), f4_apb1(1)),
    slot(0x4000_0800, 0x400, Block::Tim(2), f4_apb1(2)),
    slot(0x4000_3000, 0x400, Block::Iwdg, None),
    slot(0x4000_4400, 0x400, Block::Usart(1), f4_apb1(17)),
    slot(0x4000_4800, 0x400, Block::Usart(2), f4_apb1(18)),
    slot(0x4000_6400, 0x400, Block::Can, f4_apb1(25)),
    slot(0x4000_7000, 0x400, Block::Pwr, f4_apb1(28)),
    slot(0x4001_1000, 0x400, Block::Usart(0), f4_apb2(4)),
    slot(0x4001_2000, 0x400, Block::Adc, f4_apb2(8)),
    slot(0x4002_0000, 0x400, Block::Gpio(0), f4_ahb1(0)),
    slot(0x4002_0400, 0x400, Block::Gpio(1), f4_ahb1(1)),
    slot(0x4002_0800, 0x400, Block::Gpio(2), f4_ahb1(2)),
    slot(0x4002_0C00, 0x400, Block::Gpio(3), f4_ahb1(3)),
    slot(0x4002_1000, 0x400, Block::Gpio(4), f4_ahb1(4)),
    slot(0x4002_1400, 0x400, Block::Gpio(5), f4_ahb1(5)),
    slot(0x4002_1800, 0x400, Block::Gpio(6), f4_ahb1(6)),
    slot(0x4002_1C00, 0x400, Block::Gpio(7), f4_ahb1(7)),
    slot(0x4002_3800, 0x400, Block::Rcc, None),
    slot(0x4002_3C00, 0x400, Block::Flash, None),
    slot(0x4002_6000, 0x400, Block::Dma(0), f4_ahb1(21)),
    slot(0x4002_6400, 0x400, Block::Dma(1), f4_ahb1(22)),
    slot(0xE004_2000, 0x400, Block::Dbgmcu, None),
];

/// RM0316 3.2.2 (addresses), 9.4.4-9.4.11 (gates).
static F303_SLOTS: [Slot; 18] = [
    slot(0x4000_0000, 0x400, Block::Tim(0), f3_apb1(0)),
    slot(0x4000_0400, 0x400, Block::Tim(1), f3_apb1(1)),
    slot(0x4000_3000, 0x400, Block::Iwdg, None),
    slot(0x4000_4400, 0x400, Block::Usart(1), f3_apb1(17)),
    slot(0x4000_4800, 0x400, Block::Usart(2), f3_apb1(18)),
    slot(0x4000_6400, 0x400, Block::Can, f3_apb1(25)),
    slot(0x4000_7000, 0x400, Block::Pwr, f3_apb1(28)),
    slot(0x4001_3800, 0x400, Block::Usart(0), f3_apb2(14)),
    slot(0x4002_0000, 0x400, Block::Dma(0), f3_ahb(0)),
    slot(0x4002_1000, 0x400, Block::Rcc, None),
    slot(0x4002_2000, 0x400, Block::Flash, None),
    slot(0x4800_0000, 0x400, Block::Gpio(0), f3_ahb(17)),
    slot(0x4800_0400, 0x400, Block::Gpio(1), f3_ahb(18)),
    slot(0x4800_0800, 0x400, Block::Gpio(2), f3_ahb(19)),
    slot(0x4800_0C00, 0x400, Block::Gpio(3), f3_ahb(20)),
    slot(0x4800_1400, 0x400, Block::Gpio(5), f3_ahb(22)),
    slot(0x5000_0000, 0x400, Block::Adc, f3_ahb(28)),
    slot(0xE004_2000, 0x400, Block::Dbgmcu, None),
];

/// A peripheral's request line at a DMA controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    UsartReceive(usize),
    UsartTransmit(usize),
    Adc,
}

/// Where a request line arrives: controller, stream or channel (from 0), selector.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Route {
    pub request: Request,
    pub controller: usize,
    pub unit: usize,
    pub selector: u32,
}

const fn route(request: Request, controller: usize, unit: usize, selector: u32) -> Route {
    Route {
        request,
        controller,
        unit,
        selector,
    }
}

/// RM0390 tables 28 and 29.
static F446_ROUTES: [Route; 10] = [
    route(Request::UsartReceive(2), 0, 1, 4),
    route(Request::UsartTransmit(2), 0, 3, 4),
    route(Request::UsartTransmit(2), 0, 4, 7),
    route(Request::UsartReceive(1), 0, 5, 4),
    route(Request::UsartTransmit(1), 0, 6, 4),
    route(Request::Adc, 1, 0, 0),
    route(Request::UsartReceive(0), 1, 2, 4),
    route(Request::Adc, 1, 4, 0),
    route(Request::UsartReceive(0), 1, 5, 4),
    route(Request::UsartTransmit(0), 1, 7, 4),
];

/// RM0316 table 78 (STM32F303x6/8), without the remaps of SYSCFG.
static F303_ROUTES: [Route; 7] = [
    route(Request::Adc, 0, 0, 0),
    route(Request::UsartTransmit(2), 0, 1, 0),
    route(Request::UsartReceive(2), 0, 2, 0),
    route(Request::UsartTransmit(0), 0, 3, 0),
    route(Request::UsartReceive(0), 0, 4, 0),
    route(Request::UsartReceive(1), 0, 5, 0),
    route(Request::UsartTransmit(1), 0, 6, 0),
];

/// A pin: port letter and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pin {
    /// `'A'` and so on.
    pub port: char,
    /// 0..=15.
    pub number: u8,
}

impl Pin {
    /// The pin `number` of port `port` ('A'..='H').
    #[must_use]
    pub const fn new(port: char, number: u8) -> Self {
        Self { port, number }
    }

    pub(crate) fn port_index(self) -> usize {
        (self.port as usize).wrapping_sub('A' as usize)
    }
}

impl std::fmt::Display for Pin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "P{}{}", self.port, self.number)
    }
}

/// The pins that a sled wires to a peripheral, and the alternate function that puts the
/// peripheral there (data sheets, tables of alternate functions).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wired {
    pub transmit: Pin,
    pub receive: Pin,
    pub function: u8,
}

const fn wired(transmit: Pin, receive: Pin, function: u8) -> Wired {
    Wired {
        transmit,
        receive,
        function,
    }
}

impl Part {
    /// Flash memory.
    #[must_use]
    pub const fn flash(self) -> Memory {
        Memory {
            base: 0x0800_0000,
            size: match self {
                Self::F446 => 512 * 1024,
                Self::F303 => 64 * 1024,
            },
            dma: true,
        }
    }

    /// Memories that can be written: RAM and, on the F303, the core-coupled memory.
    #[must_use]
    pub const fn memories(self) -> &'static [Memory] {
        match self {
            Self::F446 => &[Memory {
                base: 0x2000_0000,
                size: 128 * 1024,
                dma: true,
            }],
            Self::F303 => &[
                Memory {
                    base: 0x2000_0000,
                    size: 12 * 1024,
                    dma: true,
                },
                Memory {
                    base: 0x1000_0000,
                    size: 4 * 1024,
                    dma: false,
                },
            ],
        }
    }

    /// The read-only system page that holds the unique identifier and the flash size:
    /// its base, the address of the identifier, the address of the size in KiB.
    pub(crate) const fn system_page(self) -> (u32, u32, u32) {
        match self {
            Self::F446 => (0x1FFF_7800, 0x1FFF_7A10, 0x1FFF_7A22),
            Self::F303 => (0x1FFF_F400, 0x1FFF_F7AC, 0x1FFF_F7CC),
        }
    }

    /// DBGMCU_IDCODE: device identifier and a revision.
    pub(crate) const fn idcode(self) -> u32 {
        match self {
            Self::F446 => 0x1000_0421,
            Self::F303 => 0x1000_0438,
        }
    }

    pub(crate) fn slots(self) -> &'static [Slot] {
        match self {
            Self::F446 => &F446_SLOTS,
            Self::F303 => &F303_SLOTS,
        }
    }

    pub(crate) fn routes(self) -> &'static [Route] {
        match self {
            Self::F446 => &F446_ROUTES,
            Self::F303 => &F303_ROUTES,
        }
    }

    /// Pins of USART 0.. (USART1..) on the sled.
    pub(crate) const fn usart_pins(self, index: usize) -> Option<Wired> {
        match (self, index) {
            (_, 0) => Some(wired(Pin::new('A', 9), Pin::new('A', 10), 7)),
            (Self::F446, 1) => Some(wired(Pin::new('A', 2), Pin::new('A', 3), 7)),
            (Self::F303, 1) => Some(wired(Pin::new('A', 2), Pin::new('A', 15), 7)),
            (Self::F446, 2) => Some(wired(Pin::new('C', 10), Pin::new('C', 11), 7)),
            _ => None,
        }
    }

    /// Pins of the CAN transceiver on the sled.
    pub(crate) const fn can_pins(self) -> Wired {
        match self {
            Self::F446 => wired(Pin::new('B', 9), Pin::new('B', 8), 9),
            Self::F303 => wired(Pin::new('A', 12), Pin::new('A', 11), 9),
        }
    }

    /// The part as the CAN model knows it.
    pub(crate) const fn can_part(self) -> can_bus::Part {
        match self {
            Self::F446 => can_bus::Part::F446,
            Self::F303 => can_bus::Part::F303,
        }
    }

    /// Rate of the internal RC oscillator, Hz.
    pub(crate) const fn hsi_hz(self) -> u64 {
        match self {
            Self::F446 => 16_000_000,
            Self::F303 => 8_000_000,
        }
    }

    /// Rate of the low-speed RC oscillator that drives the watchdog, Hz.
    pub(crate) const fn lsi_hz(self) -> u64 {
        match self {
            Self::F446 => 32_000,
            Self::F303 => 40_000,
        }
    }

    /// Interrupt of a timer by its index.
    pub(crate) const fn tim_irq(index: usize) -> u16 {
        28 + index as u16
    }

    /// Interrupt of a USART by its index.
    pub(crate) const fn usart_irq(index: usize) -> u16 {
        37 + index as u16
    }

    /// Interrupt of the ADC.
    pub(crate) const fn adc_irq() -> u16 {
        18
    }

    /// First of the four interrupts of the CAN controller: TX, RX0, RX1, SCE.
    pub(crate) const fn can_irq() -> u16 {
        19
    }

    /// Interrupt of stream or channel `unit` of DMA `controller`.
    pub(crate) const fn dma_irq(self, controller: usize, unit: usize) -> u16 {
        match (self, controller, unit) {
            (Self::F446, 0, 7) => 47,
            (Self::F446, 1, 0..=4) => 56 + unit as u16,
            (Self::F446, 1, _) => 68 + unit as u16 - 5,
            _ => 11 + unit as u16,
        }
    }
}
