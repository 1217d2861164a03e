//! Facts about each microcontroller that only the model needs: the addresses of its peripherals,
//! their clock gates and their DMA request lines. Memories, clocks, interrupts and pins come from
//! the crate [`parts`].
//!
//! STM32F446RE: RM0390 rev 6, memory map 2.2, DMA requests 9.3.4.
//! STM32F303K8: RM0316 rev 8, memory map 3.2, DMA requests 13.4.7.

pub use parts::{Family, Memory, Part, Pin};

/// A peripheral that is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Block {
    Rcc,
    Flash,
    Pwr,
    /// Which port is wired to each line of EXTI.
    Syscfg,
    Exti,
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
    Crc,
    /// The timer whose input can be a clock of the part.
    Capture,
    /// The timer that makes pulses.
    Pulses,
}

/// The address of a peripheral, which has 1 KiB, and its clock gate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    pub base: u32,
    pub block: Block,
    /// Offset of the enable register in RCC, offset of the reset register, bit.
    pub gate: Option<(u32, u32, u32)>,
}

/// The timers that are modelled, in the order of their index.
pub(crate) const TIMERS: [u8; 4] = [2, 3, 4, 7];
/// Index of TIM3 in [`TIMERS`], whose TRGO starts the ADC scans.
pub(crate) const TIM3: usize = 1;

/// The pin of channel 1 of the F303's TIM3, and its alternate function (DS9866, alternate functions
/// of port B). The other pins that can be this channel are not connected to the model.
pub(crate) const TIM3_INPUT: (Pin, u8) = (Pin::new('B', 4), 2);

const fn slot(base: u32, block: Block, gate: Option<(u32, u32, u32)>) -> Slot {
    Slot { base, block, gate }
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
static F446_SLOTS: [Slot; 27] = [
    slot(0x4000_0000, Block::Tim(0), f4_apb1(0)),
    slot(0x4000_0400, Block::Tim(1), f4_apb1(1)),
    slot(0x4000_0800, Block::Tim(2), f4_apb1(2)),
    slot(0x4000_3000, Block::Iwdg, None),
    slot(0x4000_4400, Block::Usart(1), f4_apb1(17)),
    slot(0x4000_4800, Block::Usart(2), f4_apb1(18)),
    slot(0x4000_6400, Block::Can, f4_apb1(25)),
    slot(0x4000_7000, Block::Pwr, f4_apb1(28)),
    slot(0x4001_1000, Block::Usart(0), f4_apb2(4)),
    slot(0x4001_2000, Block::Adc, f4_apb2(8)),
    slot(0x4001_3800, Block::Syscfg, f4_apb2(14)),
    slot(0x4001_3C00, Block::Exti, None),
    slot(0x4001_4800, Block::Capture, f4_apb2(18)),
    slot(0x4002_0000, Block::Gpio(0), f4_ahb1(0)),
    slot(0x4002_0400, Block::Gpio(1), f4_ahb1(1)),
    slot(0x4002_0800, Block::Gpio(2), f4_ahb1(2)),
    slot(0x4002_0C00, Block::Gpio(3), f4_ahb1(3)),
    slot(0x4002_1000, Block::Gpio(4), f4_ahb1(4)),
    slot(0x4002_1400, Block::Gpio(5), f4_ahb1(5)),
    slot(0x4002_1800, Block::Gpio(6), f4_ahb1(6)),
    slot(0x4002_1C00, Block::Gpio(7), f4_ahb1(7)),
    slot(0x4002_3000, Block::Crc, f4_ahb1(12)),
    slot(0x4002_3800, Block::Rcc, None),
    slot(0x4002_3C00, Block::Flash, None),
    slot(0x4002_6000, Block::Dma(0), f4_ahb1(21)),
    slot(0x4002_6400, Block::Dma(1), f4_ahb1(22)),
    slot(0xE004_2000, Block::Dbgmcu, None),
];

/// RM0316 3.2.2 (addresses), 9.4.4-9.4.11 (gates).
static F303_SLOTS: [Slot; 22] = [
    slot(0x4000_0000, Block::Tim(0), f3_apb1(0)),
    slot(0x4000_0400, Block::Tim(1), f3_apb1(1)),
    slot(0x4000_1400, Block::Tim(3), f3_apb1(5)),
    slot(0x4000_3000, Block::Iwdg, None),
    slot(0x4000_4400, Block::Usart(1), f3_apb1(17)),
    slot(0x4000_4800, Block::Usart(2), f3_apb1(18)),
    slot(0x4000_6400, Block::Can, f3_apb1(25)),
    slot(0x4000_7000, Block::Pwr, f3_apb1(28)),
    slot(0x4001_2C00, Block::Pulses, f3_apb2(11)),
    slot(0x4001_3800, Block::Usart(0), f3_apb2(14)),
    slot(0x4001_4400, Block::Capture, f3_apb2(17)),
    slot(0x4002_0000, Block::Dma(0), f3_ahb(0)),
    slot(0x4002_1000, Block::Rcc, None),
    slot(0x4002_2000, Block::Flash, None),
    slot(0x4002_3000, Block::Crc, f3_ahb(6)),
    slot(0x4800_0000, Block::Gpio(0), f3_ahb(17)),
    slot(0x4800_0400, Block::Gpio(1), f3_ahb(18)),
    slot(0x4800_0800, Block::Gpio(2), f3_ahb(19)),
    slot(0x4800_0C00, Block::Gpio(3), f3_ahb(20)),
    slot(0x4800_1400, Block::Gpio(5), f3_ahb(22)),
    slot(0x5000_0000, Block::Adc, f3_ahb(28)),
    slot(0xE004_2000, Block::Dbgmcu, None),
];

/// A peripheral's request line at a DMA controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    UsartReceive(usize),
    UsartTransmit(usize),
    Adc,
}

/// The destination of a request line: controller, stream or channel (from 0), selector.
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

/// Facts about a microcontroller that [`parts`] does not have: the addresses of its peripherals and
/// the destinations of their DMA requests.
pub(crate) trait Layout {
    /// The peripherals that are modelled.
    fn slots(&self) -> &'static [Slot];
    /// Their DMA requests.
    fn routes(&self) -> &'static [Route];
}

impl Layout for Part {
    fn slots(&self) -> &'static [Slot] {
        match self.family {
            Family::F4 => &F446_SLOTS,
            Family::F3 => &F303_SLOTS,
        }
    }

    fn routes(&self) -> &'static [Route] {
        match self.family {
            Family::F4 => &F446_ROUTES,
            Family::F3 => &F303_ROUTES,
        }
    }
}
