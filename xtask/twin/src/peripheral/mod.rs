//! The peripherals of a microcontroller as one state, updated whenever the program or the run loop
//! accesses it.
//!
//! Times are core cycles of the node. Nothing changes between two events. Therefore a node may
//! sleep from one event to the next, and a register always reads as it would in the current cycle.

mod adc;
mod capture;
mod crc;
mod dma;
mod exti;
mod gpio;
mod iwdg;
mod programming;
mod pulse;
mod rcc;
mod system;
mod tim;
mod usart;

pub(crate) use adc::REFERENCE_COUNT;
pub use rcc::ResetCause;

use crate::clock::{Cycles, LocalClock, NEVER, Ps};
use crate::part::{
    Block, Family, Layout, Part, Pin, Request, Route, Slot, TIM3, TIM3_INPUT, TIMERS,
};
use crate::silicon::registers::Access;
use crate::silicon::{self, Violation};
use crate::stores::{Bytes, among};
use can_bus::{ClockRate, NodeId, SimTime};
use parts::{Role, Signal, Sled, TimerOutput, interrupt};
use rsemu::core::device::Device;
use rsemu::core::space::{MemAttrs, MemOps, RamStore, RegionKind};
use rsemu::core::state::{ChunkReader, MachineShape, StateReader, StateWriter};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The bus that the nodes of a network share.
pub type SharedBus = Arc<Mutex<can_bus::Bus>>;

/// Locks the bus. A run has a single thread, so a poisoned lock cannot matter.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A byte that a node transmitted on one of its UARTs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UartByte {
    /// Number of the USART: 1 for USART1.
    pub usart: u8,
    /// Beginning of its start bit.
    pub start: SimTime,
    /// End of its last stop bit.
    pub end: SimTime,
    /// Beginning of each of its ten bits, and the end of the last one.
    pub edges: [SimTime; 11],
    /// When the part let go of the line before the end; the line is high from then on.
    pub cut: Option<SimTime>,
    /// The byte.
    pub byte: u8,
    /// Baud rate of the byte, bit/s, rounded.
    pub baud: u32,
}

/// An output pin changed its level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinChange {
    /// When.
    pub at: SimTime,
    /// Which.
    pub pin: Pin,
    /// Its level from now on.
    pub high: bool,
}

/// The converter began conversions, by a trigger or by software.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Burst {
    /// When.
    pub at: SimTime,
    /// Its first channel.
    pub channel: usize,
}

/// A memory that can be written.
#[derive(Debug, Clone)]
pub(crate) struct Ram {
    pub base: u32,
    pub store: Arc<RamStore>,
    /// Whether the DMA controllers reach it.
    pub dma: bool,
}

impl Ram {
    /// Another memory with the same contents.
    pub(crate) fn copy(&self) -> Self {
        let mut contents = vec![0; self.store.len() as usize];
        let store = RamStore::new(self.store.len());
        // Both have this length.
        let _ = self.store.read_at(0, &mut contents);
        let _ = store.write_at(0, &contents);
        Self {
            store: Arc::new(store),
            ..*self
        }
    }
}

/// The node's place on the bus.
#[derive(Debug, Clone)]
pub(crate) struct CanLink {
    pub bus: SharedBus,
    pub node: NodeId,
}

/// Deviation of the oscillators from nominal, parts in 10^9.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Oscillators {
    /// External clock at OSC_IN, Hz; `None`: not connected.
    pub hse_hz: Option<u64>,
    pub crystal_ppb: i64,
    pub rc_ppb: i64,
    /// Frequency of the oscillator of the watchdog (LSI), Hz.
    pub watchdog_hz: u64,
}

#[derive(Clone, Debug)]
pub(crate) struct Peripherals {
    part: &'static Part,
    /// The board around the part, which says what its pins are wired to.
    sled: Option<&'static Sled>,
    oscillators: Oscillators,
    clock: LocalClock,
    now: Cycles,
    next: Cycles,
    /// Next cycle at which the CAN controller or the watchdog may change.
    watchdog_at: Cycles,
    rcc: rcc::Rcc,
    flash: system::Flash,
    programming: programming::Programming,
    pwr: system::Pwr,
    exti: exti::Exti,
    debug_control: [u32; 3],
    iwdg: iwdg::Iwdg,
    ports: Vec<gpio::Port>,
    timers: Vec<tim::Timer>,
    usarts: Vec<usart::Usart>,
    dmas: Vec<dma::Dma>,
    adc: adc::Adc,
    crc: crc::Crc,
    capture: capture::Capture,
    pulses: pulse::Pulses,
    /// The pins of its outputs, and their levels.
    pulse_pins: Vec<(TimerOutput, &'static Signal, bool)>,
    /// Whether the external clock gets to the capturing timer.
    measured: bool,
    can: Option<CanLink>,
    /// Whether a transceiver is at the CAN pins.
    transceiver: bool,
    can_lines: u32,
    flash_image: Arc<[u8]>,
    memories: Vec<Ram>,
    /// Levels of the interrupt lines, one bit each.
    pub(crate) lines: [u32; 4],
    pub(crate) reset_request: Option<ResetCause>,
    /// The program wrote to the CAN controller.
    pub(crate) can_written: bool,
    seen_generation: u32,
    /// Counts changes of the core's rate and of its flash.
    pub(crate) generation: u32,
    levels: [u32; 8],
    /// Pins that the part drives.
    outputs: [u32; 8],
    pub(crate) sent: Vec<UartByte>,
    pub(crate) pins: Vec<PinChange>,
    pub(crate) bursts: Vec<Burst>,
    /// Registers that the program accessed but the model lacks.
    pub(crate) unmodelled: BTreeSet<u32>,
    /// What a register without a model reads as the next time, if such registers change.
    changing: Option<u32>,
    /// The request that each DMA controller serves, by the index of its route, and when the
    /// transfer takes place.
    serving: [Option<(usize, Cycles)>; 2],
    /// Prescalers that are still in force, and until when.
    fading: Option<(silicon::clocks::Prescalers, Cycles)>,
    table: &'static silicon::registers::Table,
    /// Slot of each page of addresses, from 1; 0 means that there is none.
    slots: Box<[u8]>,
    /// Page of the table for each slot.
    pages: Vec<Option<usize>>,
    /// First cycle at which each slot can be used after its clock was enabled.
    usable_from: Vec<Cycles>,
    violations: silicon::Log,
    /// Addresses of words of memory, sorted, of which transfers are noted that write to them.
    pub(crate) watched: Box<[u32]>,
    /// Such transfers: controller and stream or channel from zero on, and the word.
    pub(crate) reached: Vec<(usize, usize, u32)>,
    /// Whether the bytes are noted that transfers write to.
    pub(crate) notes_writes: bool,
    /// Those bytes: the first and the last address.
    pub(crate) written: Vec<Bytes>,
    /// Whether all transfers are noted.
    pub(crate) notes_transfers: bool,
    /// All of them: controller and stream or channel from zero on, when, and the address read.
    pub(crate) moved: Vec<(usize, usize, Cycles, u32)>,
}

/// The bus's response to an access outside every peripheral.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Nothing;

impl Peripherals {
    pub(crate) fn new(
        part: &'static Part,
        oscillators: Oscillators,
        origin: Ps,
        can: Option<CanLink>,
        flash_image: Arc<[u8]>,
        memories: Vec<Ram>,
    ) -> Result<Self, rsemu::Error> {
        let mut peripherals = Self {
            part,
            sled: Sled::carrying(part),
            oscillators,
            clock: LocalClock::new(u64::from(part.hsi.hz), oscillators.rc_ppb, origin),
            now: 0,
            next: NEVER,
            watchdog_at: NEVER,
            rcc: rcc::Rcc::new(part, oscillators.hse_hz),
            flash: system::Flash::new(part.family),
            programming: programming::Programming::new(part, &flash_image),
            pwr: system::Pwr::new(part),
            exti: exti::Exti::default(),
            debug_control: [0; 3],
            iwdg: iwdg::Iwdg::new(part.family, oscillators.watchdog_hz),
            ports: (0..8).map(|k| gpio::Port::new(part.family, k)).collect(),
            timers: TIMERS
                .into_iter()
                .map(tim::Timer::new)
                .collect::<Result<_, _>>()?,
            usarts: (0..3).map(|_| usart::Usart::new(part.family)).collect(),
            dmas: (0..2).map(|_| dma::Dma::new(part.family)).collect(),
            adc: adc::Adc::new(part.family),
            crc: crc::Crc::new(part.family),
            capture: capture::Capture::default(),
            pulses: pulse::Pulses::new(),
            pulse_pins: pulse_pins(part),
            measured: true,
            can,
            transceiver: true,
            can_lines: 0,
            flash_image,
            memories,
            lines: [0; 4],
            reset_request: None,
            can_written: false,
            seen_generation: 0,
            generation: 0,
            levels: [0; 8],
            outputs: [0; 8],
            sent: Vec::new(),
            pins: Vec::new(),
            bursts: Vec::new(),
            unmodelled: BTreeSet::new(),
            changing: None,
            serving: [None; 2],
            fading: None,
            table: silicon::registers::Table::of(part),
            slots: slots_by_page(part),
            pages: part
                .slots()
                .iter()
                .map(|slot| silicon::registers::Table::of(part).page(slot.base))
                .collect(),
            usable_from: vec![0; part.slots().len()],
            violations: silicon::Log::default(),
            watched: Box::default(),
            notes_writes: false,
            written: Vec::new(),
            notes_transfers: false,
            moved: Vec::new(),
            reached: Vec::new(),
        };
        for (levels, port) in peripherals.levels.iter_mut().zip(&peripherals.ports) {
            *levels = port.levels();
        }
        peripherals.retune(true);
        peripherals.connect_can();
        peripherals.refresh();
        Ok(peripherals)
    }

    /// The same state, for a copy of the microcontroller with these memories and this place on the bus.
    pub(crate) fn copy(&self, can: Option<CanLink>, memories: Vec<Ram>) -> Self {
        Self {
            can,
            memories,
            ..self.clone()
        }
    }

    pub(crate) fn clock(&self) -> &LocalClock {
        &self.clock
    }

    pub(crate) fn next_event(&self) -> Cycles {
        self.next
    }

    /// FLASH_ACR.
    pub(crate) fn flash_control(&self) -> u32 {
        self.flash.read(0).unwrap_or(0)
    }

    /// Offset and size of what the program can change in the flash.
    pub(crate) fn changeable(&self) -> (u32, usize) {
        self.programming.range()
    }

    /// What lies at this offset of the flash, where the program can change it.
    pub(crate) fn changed_flash(&self, offset: u32, size: usize) -> Option<&[u8]> {
        self.programming.bytes(offset, size)
    }

    /// The program stores bytes at this offset of the flash.
    pub(crate) fn store_flash(&mut self, offset: u32, bytes: &[u8]) {
        let (now, clock) = (self.now, self.clock);
        self.programming.store(offset, bytes, now, &clock);
        self.stall();
    }

    /// Writes a register of the flash.
    fn write_flash(&mut self, address: u32, offset: u32, value: u32) {
        if offset == 0 {
            self.flash.write(offset, value);
            self.generation += 1;
            self.check_clocks();
            return;
        }
        let (now, clock) = (self.now, self.clock);
        let done = self.programming.write(offset, value, now, &clock);
        if let Err(what) = done {
            self.violate(address, what.to_owned(), "RM0390 3.5, RM0316 4.2");
        }
        self.stall();
    }

    /// The run loop has to look at [`Self::stalled_until`].
    fn stall(&mut self) {
        if self.programming.next_event() != NEVER {
            self.generation += 1;
            self.refresh();
        }
    }

    /// Until when the core waits for the flash; [`NEVER`] if it does not.
    pub(crate) fn stalled_until(&self) -> Cycles {
        self.programming.next_event()
    }

    /// True if the run loop must process the peripherals, interrupt lines aside.
    pub(crate) fn wants_attention(&self) -> bool {
        self.reset_request.is_some()
            || self.can_written
            || self.seen_generation != self.generation
            || !self.reached.is_empty()
            || !self.written.is_empty()
    }

    /// The run loop has processed the peripherals.
    pub(crate) fn attended(&mut self) {
        self.seen_generation = self.generation;
    }

    /// The time up to which the node may run without missing an event on the bus.
    pub(crate) fn can_horizon(&self) -> SimTime {
        self.can
            .as_ref()
            .map_or(SimTime::from_ticks(NEVER), |link| {
                lock(&link.bus).horizon_of(link.node)
            })
    }

    fn time(&self) -> SimTime {
        SimTime::from_ticks(self.clock.time(self.now))
    }

    /// Resets the whole part except its memories.
    pub(crate) fn reset(&mut self, cause: ResetCause, now: Cycles) {
        self.catch_up(now);
        self.reset_request = None;
        self.rcc.reset(cause);
        self.fading = None;
        self.serving = [None; 2];
        self.flash = system::Flash::new(self.part.family);
        self.programming.advance(now);
        self.programming.reset();
        self.pwr.reset();
        self.exti.reset();
        self.watch_supply();
        self.debug_control = [0; 3];
        self.iwdg = iwdg::Iwdg::new(self.part.family, self.oscillators.watchdog_hz);
        self.watchdog_at = NEVER;
        for usart in &mut self.usarts {
            usart.reset(now);
        }
        // Before the pins are released.
        self.collect_sent();
        for port in 0..self.ports.len() {
            self.ports[port].reset();
            self.watch_port(port);
        }
        for timer in &mut self.timers {
            timer.reset();
        }
        for dma in &mut self.dmas {
            *dma = dma::Dma::new(self.part.family);
        }
        self.adc.reset();
        self.crc = crc::Crc::new(self.part.family);
        self.capture.reset();
        self.pulses.reset();
        if let Some(link) = &self.can {
            lock(&link.bus).reset(link.node, SimTime::from_ticks(self.clock.time(now)));
        }
        self.retune(false);
        self.connect_can();
        self.read_can_lines();
        self.refresh();
    }

    /// Updates all peripherals to cycle `now`.
    pub(crate) fn catch_up(&mut self, now: Cycles) {
        while self.next <= now {
            self.now = self.next;
            self.process();
            self.refresh();
        }
        self.now = self.now.max(now);
    }

    /// Handles the events of the current cycle.
    fn process(&mut self) {
        let now = self.now;
        if self.rcc.next_event(now.saturating_sub(1)) <= now {
            self.rcc.settle(now, &self.clock);
            self.retune(false);
            self.check_clocks();
        }
        for timer in &mut self.timers {
            timer.advance(now);
        }
        self.pulses.advance(now);
        self.programming.advance(now);
        self.forward_triggers();
        self.adc.advance(now);
        for usart in &mut self.usarts {
            usart.advance(now);
        }
        if self.watchdog_at <= now {
            if self.iwdg.expired(self.clock.time(now)) {
                self.reset_request = Some(ResetCause::Watchdog);
                self.watchdog_at = NEVER;
            } else {
                self.watchdog_at = self.clock.cycle_from(self.iwdg.expires()).max(now + 1);
            }
        }
        self.watch_supply();
        self.serve_dma();
    }

    fn forward_triggers(&mut self) {
        let rises = self.timers[TIM3].take_triggers();
        for _ in 0..rises {
            self.adc.tim3_trigger(self.now);
        }
    }

    /// Recomputes the next event and the interrupt lines after a change.
    fn refresh(&mut self) {
        self.collect_sent();
        self.watch_pulses();
        if let Some((at, channel)) = self.adc.take_begun() {
            let at = SimTime::from_ticks(self.clock.time(at));
            self.bursts.push(Burst { at, channel });
        }
        let mut next = self.rcc.next_event(self.now).min(self.watchdog_at);
        next = next.min(self.pwr.next_event(self.now));
        for timer in &self.timers {
            next = next.min(timer.next_event());
        }
        for usart in &self.usarts {
            next = next.min(usart.next_event());
        }
        for (_, at) in self.serving.iter().flatten() {
            next = next.min(*at);
        }
        self.next = next
            .min(self.adc.next_event())
            .min(self.pulses.next_event())
            .min(self.programming.next_event());

        let mut lines = [0_u32; 4];
        let mut raise = |irq: u16, level: bool| {
            lines[usize::from(irq / 32)] |= u32::from(level) << (irq % 32);
        };
        for timer in &self.timers {
            raise(timer.irq(), timer.interrupt());
        }
        for (k, usart) in self.usarts.iter().enumerate() {
            raise(interrupt::USART1 + k as u16, usart.interrupt());
        }
        for (controller, dma) in self.dmas.iter().enumerate() {
            if controller == 1 && self.part.family == Family::F3 {
                break;
            }
            for unit in 0..dma.units() {
                raise(
                    interrupt::dma(self.part.family, controller, unit),
                    dma.interrupt(unit),
                );
            }
        }
        raise(interrupt::ADC, self.adc.interrupt());
        raise(interrupt::PVD, self.exti.interrupt(exti::VOLTAGE));
        for k in 0..5 {
            raise(interrupt::EXTI0 + k, self.exti.interrupt(u32::from(k)));
        }
        for k in 0..4 {
            raise(interrupt::CAN + k, self.can_lines >> k & 1 != 0);
        }
        self.lines = lines;
    }

    /// Whether the pin of each transmitter is connected to it.
    fn transmitters(&self) -> [bool; 3] {
        core::array::from_fn(|k| routed(&self.ports, self.sled, Role::UsartTransmit(k as u8 + 1)))
    }

    /// Ends the bytes of the transmitters that have lost their pin since `before`.
    fn cut_transmitters(&mut self, before: [bool; 3]) {
        let after = self.transmitters();
        for k in 0..self.usarts.len() {
            if before[k] && !after[k] {
                self.usarts[k].cut(self.now);
                self.publish(k);
            }
        }
    }

    fn collect_sent(&mut self) {
        for k in 0..self.usarts.len() {
            if self.usarts[k].has_sent() {
                if routed(&self.ports, self.sled, Role::UsartTransmit(k as u8 + 1)) {
                    self.publish(k);
                } else {
                    self.usarts[k].drain_sent();
                }
            }
        }
    }

    /// The bytes of a transmitter appear on its pin.
    fn publish(&mut self, k: usize) {
        let hertz = self.clock.hertz();
        for sent in self.usarts[k].drain_sent() {
            let baud = (hertz * 256 + sent.bit256 / 2) / sent.bit256;
            let edges = sent.times(&self.clock).map(SimTime::from_ticks);
            let cut = sent.cut.map(|cut| self.clock.time(cut));
            self.sent.push(UartByte {
                usart: k as u8 + 1,
                start: edges[0],
                end: edges[edges.len() - 1],
                edges,
                cut: cut.map(SimTime::from_ticks),
                byte: sent.byte,
                baud: u32::try_from(baud).unwrap_or(u32::MAX),
            });
        }
    }

    // -- clocks ---------------------------------------------------------------------

    /// Core cycles in a cycle of the peripheral bus on which this address is; `None` on another bus.
    pub(crate) fn bus_periods(&self, address: u32) -> Option<u64> {
        let tree = self.rcc.tree();
        match address {
            0x4000_0000..0x4001_0000 => Some(tree.apb1),
            0x4001_0000..0x4002_0000 => Some(tree.apb2),
            _ => None,
        }
    }

    /// Applies changes of the clock tree to the peripherals.
    fn retune(&mut self, first: bool) {
        let now = self.now;
        let tree = self.rcc.tree();
        let ppb = if tree.external {
            self.oscillators.crystal_ppb
        } else {
            self.oscillators.rc_ppb + self.rcc.trim_ppb()
        };
        let before = self.clock;
        if before.hertz() != tree.hclk || before.ppb() != ppb {
            self.clock.set_rate(now, tree.hclk, ppb);
            self.generation += 1;
            let after = self.clock;
            let scale = move |at: Cycles| after.cycle_from(before.time(at));
            self.rcc.rescale(now, scale);
            self.pwr.rescale(now, scale);
            self.adc.rescale(now, scale);
            for usart in &mut self.usarts {
                usart.reclock(now, &before, scale);
            }
            if self.watchdog_at != NEVER {
                self.watchdog_at = scale(self.watchdog_at);
            }
        }
        for k in 0..self.timers.len() {
            let clocked = self.gate_open(Block::Tim(k));
            self.timers[k].set_clock(now, clocked, tree.timer1);
        }
        let clocked = self.gate_open(Block::Pulses);
        self.pulses.set_clock(now, clocked, tree.timer2);
        for k in 0..self.usarts.len() {
            let divider = match (self.part.family, k) {
                (Family::F4, 0) => tree.apb2,
                // USART1's own clock selection (RM0316 9.4.13).
                (Family::F3, 0) => match self.rcc.cfgr3() & 3 {
                    0 => tree.apb1,
                    1 => 1,
                    _ => (tree.hclk / u64::from(self.part.hsi.hz)).max(1),
                },
                _ => tree.apb1,
            };
            self.usarts[k].set_divider(now, divider);
        }
        // ADC12PRES: off below 16, then 1, 2, 4, 6, 8, 10, 12, 16 and on (RM0316 9.4.12).
        let asynchronous = match self.rcc.cfgr2() >> 4 & 0x1F {
            code @ 16..=27 => [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256][code as usize - 16],
            _ => 1,
        };
        self.adc.set_clock(tree.apb2, asynchronous);
        if let Some(link) = &self.can {
            let hertz = u32::try_from(tree.hclk / tree.apb1).unwrap_or(u32::MAX);
            let ppb = i32::try_from(ppb).unwrap_or(0);
            let rate = ClockRate::new(hertz).with_offset_ppb(ppb);
            if first || before.hertz() != tree.hclk || before.ppb() != i64::from(ppb) {
                let at = SimTime::from_ticks(self.clock.time(now));
                lock(&link.bus).set_clock(link.node, rate, at);
            }
        }
    }

    /// Frequency of the clock that the capturing timer measures, in millionths of a hertz; zero
    /// when that clock is off.
    fn captured(&self) -> u64 {
        let external = || {
            let hertz = i128::from(self.rcc.running_external_hz());
            let billion = 1_000_000_000 + i128::from(self.oscillators.crystal_ppb);
            u64::try_from(hertz * billion / 1000).unwrap_or(0)
        };
        match (self.part.family, self.capture.input()) {
            _ if !self.measured => 0,
            // HSE_RTC: the external clock through its own divider (RM0390 6.3.3 and 20.6.11).
            (Family::F4, 2) => match self.rcc.written(0x08) >> 16 & 0x1F {
                0 | 1 => 0,
                divider => external() / u64::from(divider),
            },
            // RM0316 23.6.16.
            (Family::F3, 2) => external() / 32,
            _ => 0,
        }
    }

    /// AHB cycles in a cycle of the bus that a requesting peripheral is on.
    fn bus_divider(&self, request: Request) -> u64 {
        let block = match request {
            Request::UsartReceive(k) | Request::UsartTransmit(k) => Block::Usart(k),
            Request::Adc => Block::Adc,
        };
        let tree = self.rcc.tree();
        let gate = self.slot_of(block).and_then(|slot| slot.gate);
        gate.map_or(1, |(enable, ..)| {
            silicon::gates::divider(self.part.family, enable, tree.apb1, tree.apb2)
        })
    }

    fn slot_of(&self, block: Block) -> Option<&'static Slot> {
        self.part.slots().iter().find(|slot| slot.block == block)
    }

    fn gate_open(&self, block: Block) -> bool {
        self.slot_of(block).is_some_and(|slot| {
            slot.gate
                .is_none_or(|(enable, _, bit)| self.rcc.enabled(enable, bit))
        })
    }

    // -- surroundings ---------------------------------------------------------------

    fn watch_port(&mut self, port: usize) {
        self.watch_input(port);
        let levels = self.ports[port].levels();
        self.exti.drive_port(port, levels);
        let changed = levels ^ self.levels[port];
        self.levels[port] = levels;
        // A pin that stops being an output changes too: its pull resistor or an external driver
        // then sets its level.
        let outputs = self.ports[port].outputs();
        let driven = std::mem::replace(&mut self.outputs[port], outputs) | outputs;
        let changed = changed & driven;
        if changed == 0 {
            return;
        }
        let at = self.time();
        for number in 0..16_u8 {
            if changed >> number & 1 != 0 {
                self.pins.push(PinChange {
                    at,
                    pin: Pin::new((b'A' + port as u8) as char, number),
                    high: levels >> number & 1 != 0,
                });
            }
        }
    }

    /// Channel 1 of TIM3 sees its pin while that is assigned to it.
    fn watch_input(&mut self, port: usize) {
        let (pin, alternate) = TIM3_INPUT;
        if self.part.family != Family::F3 || port != pin.port_index() {
            return;
        }
        let port = &self.ports[port];
        let connected = port.routed(pin.number, alternate);
        let level = connected && port.level_from_outside(pin.number);
        self.timers[TIM3].drive(level, self.now);
    }

    /// The level of a pin that a timer's output is wired to. A driver from outside is stronger than
    /// the timer; a pin that neither of them drives has the level of its pull resistor.
    fn pulse_level(&self, output: TimerOutput, signal: &Signal) -> bool {
        let port = &self.ports[signal.pin.port_index()];
        let number = signal.pin.number;
        let connected = port.routed(number, signal.alternate) && port.external(number).is_none();
        let driven = connected.then(|| self.pulses.level(output)).flatten();
        driven.unwrap_or_else(|| port.level_from_outside(number))
    }

    /// Records the edges at the pins of the timer's outputs.
    fn watch_pulses(&mut self) {
        for k in 0..self.pulse_pins.len() {
            let (output, signal, before) = self.pulse_pins[k];
            let high = self.pulse_level(output, signal);
            if high != before {
                self.pulse_pins[k].2 = high;
                let at = self.time();
                let pin = signal.pin;
                self.pins.push(PinChange { at, pin, high });
            }
        }
    }

    fn connect_can(&mut self) {
        let Some(link) = &self.can else { return };
        let routed = [Role::CanTransmit(1), Role::CanReceive(1)]
            .into_iter()
            .all(|role| routed(&self.ports, self.sled, role));
        let mut bus = lock(&link.bus);
        bus.set_connected(link.node, routed && self.transceiver, self.time());
        // Without a transceiver the pin's pull resistor sets its level, and an open pin without one
        // may read low. A driver from outside is stronger than a transceiver.
        let pin = self
            .sled
            .and_then(|sled| sled.wired_as(Role::CanReceive(1)));
        let low = pin.is_some_and(|signal| {
            let port = &self.ports[signal.pin.port_index()];
            let pin = signal.pin.number;
            let read = port.external(pin).is_some() || !self.transceiver;
            read && !port.level_from_outside(pin)
        });
        bus.hold_receive_pin(link.node, low, self.time());
    }

    /// Plugs a transceiver in at the CAN pins, or takes it away.
    pub(crate) fn set_transceiver(&mut self, present: bool) {
        self.transceiver = present;
        self.connect_can();
    }

    /// Whether the external clock gets to the timer that measures it.
    pub(crate) const fn set_measured(&mut self, measured: bool) {
        self.measured = measured;
    }

    /// Whether the watchdog has been started.
    pub(crate) const fn watchdog_runs(&self) -> bool {
        self.iwdg.runs()
    }

    /// Updates the interrupt lines of the CAN controller after the bus has been simulated further.
    pub(crate) fn read_can_lines(&mut self) {
        let Some(link) = &self.can else { return };
        let lines = lock(&link.bus).irq(link.node);
        self.can_lines = u32::from(lines.tx)
            | u32::from(lines.rx0) << 1
            | u32::from(lines.rx1) << 2
            | u32::from(lines.sce) << 3;
        for k in 0..4 {
            let irq = interrupt::CAN + k;
            let bit = 1 << (irq % 32);
            let word = &mut self.lines[usize::from(irq / 32)];
            *word = *word & !bit | if self.can_lines >> k & 1 != 0 { bit } else { 0 };
        }
    }

    /// The external clock stops. True if the core gets an NMI for it.
    pub(crate) fn lose_external_clock(&mut self) -> bool {
        let interrupts = self.rcc.lose_external();
        if interrupts {
            self.pulses.clock_failed();
        }
        self.retune(false);
        self.refresh();
        interrupts
    }

    pub(crate) fn find_external_clock(&mut self, hertz: u32) {
        self.rcc
            .find_external(u64::from(hertz), self.now, &self.clock);
        self.retune(false);
        self.refresh();
    }

    pub(crate) fn set_pll_locks(&mut self, locks: bool) {
        self.rcc.set_pll_locks(locks);
    }

    pub(crate) fn set_internal_error(&mut self, ppb: i32) {
        self.oscillators.rc_ppb = i64::from(ppb);
        self.retune(false);
        self.refresh();
    }

    /// The watchdog's oscillator has this frequency from now on.
    pub(crate) fn set_watchdog_clock(&mut self, hertz: u32) {
        let hertz = u64::from(hertz.max(1));
        self.oscillators.watchdog_hz = hertz;
        self.iwdg.set_rate(hertz, self.clock.time(self.now));
        self.watchdog_at = self.clock.cycle_from(self.iwdg.expires());
        self.refresh();
    }

    pub(crate) fn drive_pin(&mut self, pin: Pin, level: Option<bool>) {
        if let Some(port) = self.ports.get_mut(pin.port_index()) {
            port.drive(pin.number, level);
            let levels = port.levels();
            self.levels[pin.port_index()] = levels;
            self.exti.drive_port(pin.port_index(), levels);
            self.watch_input(pin.port_index());
            self.connect_can();
            self.refresh();
        }
    }

    pub(crate) fn pin_level(&self, pin: Pin) -> bool {
        self.ports
            .get(pin.port_index())
            .and_then(|_| self.input_levels(pin.port_index()))
            .is_some_and(|levels| levels >> pin.number & 1 != 0)
    }

    /// The input register of a port. It shows the level of each pin, also of those that a
    /// transmitter drives. A driver from outside is stronger: it stands for a short circuit.
    fn input_levels(&self, port: usize) -> Option<u32> {
        let mut levels = self.ports[port].read(gpio::IDR)?;
        for (k, usart) in (1..).zip(&self.usarts) {
            let role = Role::UsartTransmit(k);
            let Some(signal) = self.sled.and_then(|sled| sled.wired_as(role)) else {
                continue;
            };
            let number = signal.pin.number;
            if signal.pin.port_index() == port
                && self.ports[port].external(number).is_none()
                && routed(&self.ports, self.sled, role)
                && let Some(high) = usart.line(self.now)
            {
                levels = levels & !(1 << number) | u32::from(high) << number;
            }
        }
        for (output, signal, _) in &self.pulse_pins {
            let number = signal.pin.number;
            if signal.pin.port_index() == port && self.ports[port].routed(number, signal.alternate)
            {
                let high = self.pulse_level(*output, signal);
                levels = levels & !(1 << number) | u32::from(high) << number;
            }
        }
        Some(levels)
    }

    pub(crate) fn corrupt_reception(&mut self, mask: u32) {
        if let Some(link) = &self.can {
            lock(&link.bus).corrupt_reception(link.node, mask);
        }
    }

    pub(crate) fn jam_controller(&mut self, unlocked: bool) {
        if let Some(link) = &self.can {
            lock(&link.bus).jam(link.node, unlocked);
        }
    }

    /// The supply has this voltage from now on.
    pub(crate) fn set_supply(&mut self, millivolts: u16) {
        self.adc.set_supply(millivolts);
        self.pwr.set_supply(millivolts);
        self.watch_supply();
        self.check_clocks();
        self.refresh();
    }

    /// Writes a register of SYSCFG, which wires lines of EXTI to other ports.
    fn wire_lines(&mut self, offset: u32, value: u32) {
        self.exti.write_ports(offset, value);
        self.watch_lines();
    }

    /// The lines of EXTI take the levels of the pins that they are wired to.
    fn watch_lines(&mut self) {
        for (port, pins) in self.ports.iter().enumerate() {
            self.exti.drive_port(port, pins.levels());
        }
    }

    /// The voltage detector's line to EXTI takes its level.
    fn watch_supply(&mut self) {
        self.exti.drive(exti::VOLTAGE, self.pwr.is_low(self.now));
    }

    pub(crate) fn set_analog(&mut self, channel: usize, count: u16) {
        self.adc.set_input(channel, count);
    }

    /// A byte starts to arrive at time `start` at USART `usart` (numbered from 1) with `baud`
    /// bit/s.
    pub(crate) fn feed_uart(&mut self, usart: u8, byte: u8, start: Ps, baud: u32) {
        let index = usize::from(usart).wrapping_sub(1);
        if !routed(&self.ports, self.sled, Role::UsartReceive(usart)) || baud == 0 {
            return;
        }
        let second = 1_000_000_000_000 * 256 / u64::from(baud);
        let arriving = usart::Arriving {
            start: self.clock.cycle_from(start).max(self.now + 1),
            bit256: self.clock.cycles_of(second),
            byte,
        };
        self.usarts[index].receive(arriving);
        self.refresh();
    }

    // -- the bus of the microcontroller -----------------------------------------------

    /// Index of the slot that holds an address.
    fn index_at(&self, address: u32) -> Option<usize> {
        let slot = *self.slots.get(page_of(address)?)?;
        usize::from(slot).checked_sub(1)
    }

    fn slot_at(&self, address: u32) -> Option<&'static Slot> {
        self.index_at(address)
            .map(|index| &self.part.slots()[index])
    }

    /// The breaches of the part's documents so far.
    pub(crate) fn violations(&self) -> &[Violation] {
        self.violations.all()
    }

    fn violate(&mut self, address: u32, what: String, document: &'static str) {
        let register = match (self.table.name(address), self.slot_at(address)) {
            (Some(name), _) => name.to_owned(),
            (None, Some(slot)) => format!("{:?} + {:#04x}", slot.block, address - slot.base),
            (None, None) => "no register".to_owned(),
        };
        self.violations.record(Violation {
            at: self.time(),
            address,
            register,
            what,
            document,
        });
    }

    /// Records what an access of the program of `size` bytes does that its register does not allow.
    pub(crate) fn check(&mut self, address: u32, size: usize, access: Access) {
        let Some(index) = self.index_at(address) else {
            let what = "accessed, and there is no peripheral that is modelled".to_owned();
            return self.violate(address, what, self.memory_map());
        };
        let Some(page) = self.pages[index] else {
            return;
        };
        if let Err((what, document)) = self.table.check(page, address, size, access) {
            self.violate(address, what, document);
        }
    }

    /// Registers without a model read as zeros and as ones in turn from now on, those of peripherals without
    /// a model too.
    pub(crate) fn let_unmodelled_change(&mut self) {
        self.changing = Some(0);
    }

    /// What a read of a register without a model gives.
    fn without_model(&mut self, address: u32) -> Option<u32> {
        self.unmodelled.insert(address);
        let next = self.changing.as_mut()?;
        let value = *next;
        *next = !value;
        Some(value)
    }

    fn memory_map(&self) -> &'static str {
        match self.part.family {
            Family::F4 => "RM0390 2.2.2",
            Family::F3 => "RM0316 3.2.2",
        }
    }

    /// True if an access reaches the peripheral of this slot: its clock is enabled, and has been
    /// for long enough.
    fn reaches(&mut self, index: usize, address: u32) -> bool {
        let Some((enable, _, bit)) = self.part.slots()[index].gate else {
            return true;
        };
        if !self.rcc.enabled(enable, bit) {
            return false;
        }
        let missing = self.usable_from[index].saturating_sub(self.now);
        if missing == 0 {
            return true;
        }
        let what = format!("accessed {missing} cycles too early after its clock was enabled");
        self.violate(address, what, silicon::gates::DOCUMENT);
        false
    }

    /// Reads the register word at `address`.
    pub(crate) fn read(&mut self, address: u32) -> Result<u32, Nothing> {
        let Some(index) = self.index_at(address) else {
            return self.without_model(address).ok_or(Nothing);
        };
        let slot = &self.part.slots()[index];
        if !self.reaches(index, address) {
            // A peripheral without its clock reads as zero (RM0390 6.3.10, RM0316 9.4).
            return Ok(0);
        }
        let offset = address - slot.base;
        let now = self.now;
        let value = match slot.block {
            Block::Rcc => self.rcc.read(offset, now),
            Block::Flash if offset != 0 => self.programming.read(offset),
            Block::Flash => self.flash.read(offset),
            Block::Pwr => self.pwr.read(offset, now),
            Block::Syscfg => self.exti.read_ports(offset),
            Block::Exti => self.exti.read(offset),
            Block::Iwdg => self.iwdg.read(offset, self.clock.time(now)),
            Block::Dbgmcu => match offset {
                0 => Some(self.part.idcode),
                4..=12 => Some(self.debug_control[(offset / 4 - 1) as usize]),
                _ => None,
            },
            Block::Gpio(port) if offset == gpio::IDR => self.input_levels(port),
            Block::Gpio(port) => self.ports[port].read(offset),
            Block::Tim(k) => self.timers[k].read(offset, now),
            Block::Usart(k) => self.usarts[k].read(offset),
            Block::Dma(k) => self.dmas[k].read(offset),
            Block::Adc => self.adc.read(offset, now),
            Block::Crc => self.crc.read(offset),
            Block::Capture => {
                let input = self.captured();
                self.capture.read(offset, now, &self.clock, input)
            }
            Block::Pulses => self.pulses.read(offset, now),
            Block::Can => match &self.can {
                Some(link) if offset < 0x320 => Some(lock(&link.bus).read(link.node, offset)),
                // A part on no bus.
                None => Some(0),
                Some(_) => None,
            },
        };
        if matches!(slot.block, Block::Usart(_) | Block::Adc | Block::Tim(_)) {
            // Reading a data or capture register clears flags and requests.
            self.refresh();
        }
        Ok(value.unwrap_or_else(|| {
            if let Some(value) = self.without_model(address) {
                return value;
            }
            let what = "read, and it is not modelled".to_owned();
            self.violate(address, what, self.memory_map());
            0
        }))
    }

    /// Writes the register word at `address`.
    pub(crate) fn write(&mut self, address: u32, value: u32) -> Result<(), Nothing> {
        let Some(index) = self.index_at(address) else {
            return self.without_model(address).map(|_| ()).ok_or(Nothing);
        };
        let slot = &self.part.slots()[index];
        if !self.reaches(index, address) {
            return Ok(());
        }
        let offset = address - slot.base;
        let now = self.now;
        match slot.block {
            Block::Rcc => self.write_rcc(offset, value),
            Block::Flash => self.write_flash(address, offset, value),
            Block::Pwr => {
                self.check_scale(offset, value);
                self.pwr.write(offset, value, now, &self.clock);
                self.watch_supply();
                self.check_clocks();
            }
            Block::Syscfg => self.wire_lines(offset, value),
            Block::Exti => self.exti.write(offset, value),
            Block::Iwdg => {
                let time = self.clock.time(now);
                if self.iwdg.write(offset, value, time) {
                    self.reset_request = Some(ResetCause::Watchdog);
                }
                self.watchdog_at = self.clock.cycle_from(self.iwdg.expires());
            }
            Block::Dbgmcu => {
                if let 4..=12 = offset {
                    self.debug_control[(offset / 4 - 1) as usize] = value;
                }
            }
            Block::Gpio(port) => self.write_port(port, offset, value),
            Block::Tim(k) => {
                self.timers[k].write(offset, value, now);
                self.forward_triggers();
            }
            Block::Usart(k) => self.usarts[k].write(offset, value, now),
            Block::Dma(k) => self.dmas[k].write(offset, value),
            Block::Adc => {
                let clock = self.clock;
                if let Some((what, document)) = self.adc.refuse(offset, value) {
                    self.violate(address, what, document);
                }
                self.adc.write(offset, value, now, |ps| clock.cycles_of(ps));
                if offset >= 0x300 {
                    self.retune(false);
                }
                self.check_clocks();
            }
            Block::Crc => self.crc.write(offset, value),
            Block::Capture => {
                let input = self.captured();
                self.capture.write(offset, value, now, &self.clock, input);
            }
            Block::Pulses => {
                if let Some(bits) = self.pulses.write(offset, value, now) {
                    let what = format!("written with {bits:#010x}, which is not modelled");
                    self.violate(address, what, "RM0316 20.4");
                }
            }
            Block::Can => {
                if let Some(link) = &self.can
                    && offset < 0x320
                {
                    let at = SimTime::from_ticks(self.clock.time(now));
                    lock(&link.bus).write(link.node, offset, value, at);
                    self.can_written = true;
                    self.read_can_lines();
                }
            }
        }
        self.serve_dma();
        self.refresh();
        Ok(())
    }

    fn write_port(&mut self, port: usize, offset: u32, value: u32) {
        let routing = matches!(offset, 0x00 | 0x20 | 0x24);
        let before = if routing {
            self.transmitters()
        } else {
            [false; 3]
        };
        self.ports[port].write(offset, value);
        self.watch_port(port);
        if routing {
            self.cut_transmitters(before);
        }
        if routing || offset == gpio::PUPDR {
            self.connect_can();
        }
    }

    fn write_rcc(&mut self, offset: u32, value: u32) {
        let now = self.now;
        let tree = self.rcc.tree();
        for (slot, usable_from) in self.part.slots().iter().zip(&mut self.usable_from) {
            if let Some((enable, _, bit)) = slot.gate
                && enable == offset
                && value >> bit & 1 != 0
                && !self.rcc.enabled(enable, bit)
            {
                let delay = silicon::gates::delay(self.part.family, enable, tree.apb1, tree.apb2);
                *usable_from = now + delay;
            }
        }
        if self.part.family == Family::F3 && offset == 0x30 && value & 1 << 8 != 0 {
            let what = "TIM1 on the doubled clock of the PLL, which is not modelled".to_owned();
            self.violate(0x4002_1030, what, "RM0316 9.4.13");
        }
        let before = self.rcc.tree().prescalers();
        self.rcc.write(offset, value, now, &self.clock);
        let after = self.rcc.tree().prescalers();
        if after.least(before) != after {
            self.fading = Some((before, now + silicon::STORE + silicon::clocks::PRESCALER));
        }
        for slot in self.part.slots() {
            if let Some((_, reset, bit)) = slot.gate
                && reset == offset
                && value >> bit & 1 != 0
            {
                self.reset_block(slot.block);
            }
        }
        self.retune(false);
        self.check_clocks();
    }

    /// Records limits of the clocks that are exceeded from now on.
    fn check_clocks(&mut self) {
        let tree = self.rcc.tree();
        let mut prescalers = tree.prescalers();
        if let Some((before, until)) = self.fading
            && self.now < until
        {
            prescalers = prescalers.least(before);
        }
        let pll = match self.part.family {
            Family::F4 => [self.rcc.written(0x04), 0],
            Family::F3 => [self.rcc.written(0x04), self.rcc.cfgr2()],
        };
        let settings = silicon::clocks::Settings {
            system: tree.system,
            prescalers,
            cr: self.rcc.written(0),
            pll,
            external: self.rcc.external_hz(),
            flash: self.flash_control(),
            supply: self.pwr.supply(),
            power: self.pwr.read(0, self.now).unwrap_or(0),
            overdriven: self.pwr.read(4, self.now).unwrap_or(0) & 1 << 17 != 0,
            converter: self.adc.running_clock(),
        };
        for breach in silicon::clocks::check(self.part, &settings) {
            self.violate(breach.address, breach.what, breach.document);
        }
    }

    /// The F446's voltage scale may change only while the PLL is off (RM0390 5.4.1).
    fn check_scale(&mut self, offset: u32, value: u32) {
        let before = self.pwr.read(0, self.now).unwrap_or(0);
        if self.part.family == Family::F4
            && offset == 0
            && (before ^ value) & 0xC000 != 0
            && self.rcc.written(0) & 1 << 24 != 0
        {
            let what = "voltage scale changed while the PLL is on".to_owned();
            self.violate(0x4000_7000, what, "RM0390 5.4.1");
        }
    }

    fn reset_block(&mut self, block: Block) {
        match block {
            Block::Gpio(port) => {
                self.ports[port].reset();
                self.watch_port(port);
                self.connect_can();
            }
            Block::Tim(k) => self.timers[k].reset(),
            Block::Usart(k) => self.usarts[k].reset(self.now),
            Block::Dma(k) => self.dmas[k] = dma::Dma::new(self.part.family),
            Block::Adc => self.adc.reset(),
            Block::Crc => self.crc = crc::Crc::new(self.part.family),
            Block::Capture => self.capture.reset(),
            Block::Pulses => self.pulses.reset(),
            Block::Can => {
                if let Some(link) = &self.can {
                    lock(&link.bus).reset(link.node, self.time());
                }
                self.read_can_lines();
            }
            Block::Pwr => {
                self.pwr.reset();
                self.watch_supply();
            }
            Block::Syscfg => {
                self.exti.reset_ports();
                self.watch_lines();
            }
            Block::Rcc | Block::Flash | Block::Exti | Block::Iwdg | Block::Dbgmcu => {}
        }
    }

    // -- DMA ------------------------------------------------------------------------

    fn requested(&self, request: Request) -> bool {
        match request {
            Request::UsartReceive(k) => {
                self.usarts[k].receive_request() && self.gate_open(Block::Usart(k))
            }
            Request::UsartTransmit(k) => {
                self.usarts[k].transmit_request() && self.gate_open(Block::Usart(k))
            }
            Request::Adc => self.adc.dma_request() && self.gate_open(Block::Adc),
        }
    }

    /// Whether a request waits for its unit, which has something left to move.
    fn waits(&self, route: &Route) -> bool {
        let dma = &self.dmas[route.controller];
        dma.listens(route.unit, route.selector)
            && dma.item(route.unit).is_some()
            && self.requested(route.request)
            && self.gate_open(Block::Dma(route.controller))
    }

    /// Ends and begins transfers of the DMA controllers.
    fn serve_dma(&mut self) {
        let routes = self.part.routes();
        for controller in 0..self.dmas.len() {
            if let Some((index, at)) = self.serving[controller] {
                if at > self.now {
                    continue;
                }
                self.serving[controller] = None;
                let route = &routes[index];
                // The program may have taken the byte in the meantime.
                if self.waits(route)
                    && self.move_item(controller, route.unit) == Some(true)
                    && route.request == Request::Adc
                {
                    self.adc.dma_complete();
                }
            }
            let waiting = routes
                .iter()
                .enumerate()
                .filter(|(_, route)| route.controller == controller && self.waits(route));
            let next = waiting.min_by_key(|(_, route)| self.dmas[controller].rank(route.unit));
            self.serving[controller] = next.map(|(index, route)| {
                let duration = dma::transfer(self.bus_divider(route.request));
                (index, self.now + duration)
            });
        }
        for controller in 0..self.dmas.len() {
            for unit in 0..self.dmas[controller].units() {
                while self.dmas[controller].copies(unit)
                    && self.move_item(controller, unit).is_some()
                {}
            }
        }
    }

    /// Moves one item. True if it was the last of its buffer; `None` if there was nothing to move.
    fn move_item(&mut self, controller: usize, unit: usize) -> Option<bool> {
        let item = self.dmas[controller].item(unit)?;
        let moved = self
            .dma_read(item.from, item.from_size)
            .and_then(|value| self.dma_write(item.to, item.to_size, value));
        if moved.is_err() {
            self.dmas[controller].fail(unit);
            return None;
        }
        if self.notes_transfers {
            self.moved.push((controller, unit, self.now, item.from));
        }
        let bytes = (item.to, item.to.saturating_add(item.to_size - 1));
        if self.notes_writes {
            self.written.push(bytes);
        }
        let words = among(&self.watched, bytes);
        self.reached
            .extend(words.map(|word| (controller, unit, word)));
        Some(self.dmas[controller].moved(unit))
    }

    fn memory(&self, address: u32, size: u32) -> Option<(&RamStore, u64)> {
        self.memories.iter().find_map(|ram| {
            let offset = u64::from(address.checked_sub(ram.base)?);
            let inside = offset + u64::from(size) <= ram.store.len();
            (ram.dma && inside).then_some((&*ram.store, offset))
        })
    }

    fn dma_read(&mut self, address: u32, size: u32) -> Result<u32, Nothing> {
        let mut bytes = [0; 4];
        let wanted = &mut bytes[..size as usize];
        if let Some((store, offset)) = self.memory(address, size) {
            store.read_at(offset, wanted).map_err(|_| Nothing)?;
            return Ok(u32::from_le_bytes(bytes));
        }
        let flash = self.part.flash;
        if flash.contains(address) {
            let start = (address - flash.base) as usize;
            let source = self
                .flash_image
                .get(start..start + size as usize)
                .ok_or(Nothing)?;
            wanted.copy_from_slice(source);
            return Ok(u32::from_le_bytes(bytes));
        }
        let word = self.read(address & !3)?;
        Ok(word >> (8 * (address & 3)))
    }

    fn dma_write(&mut self, address: u32, size: u32, value: u32) -> Result<(), Nothing> {
        if let Some((store, offset)) = self.memory(address, size) {
            return store
                .write_at(offset, &value.to_le_bytes()[..size as usize])
                .map_err(|_| Nothing);
        }
        let slot = self.slot_at(address).ok_or(Nothing)?;
        let mask = u32::MAX >> (32 - 8 * size);
        match slot.block {
            // DMA writes go to these registers only. Calling `write` here would recurse.
            Block::Usart(k) => self.usarts[k].write(address - slot.base, value & mask, self.now),
            _ => return Err(Nothing),
        }
        Ok(())
    }
}

/// Pages of 1 KiB in the three regions that have peripherals: AHB1 and the APBs, AHB2, AHB3.
const REGIONS: [(u32, u32); 4] = [
    (0x4000_0000, 0x400),
    (0x4800_0000, 0x10),
    (0x5000_0000, 0x10),
    (0xE004_2000, 1),
];

/// Index of the page of an address among those of [`REGIONS`].
#[inline]
fn page_of(address: u32) -> Option<usize> {
    let mut first = 0;
    for (base, pages) in REGIONS {
        let page = address.wrapping_sub(base) >> 10;
        if page < pages {
            return Some((first + page) as usize);
        }
        first += pages;
    }
    None
}

/// The slot of each page, from 1.
fn slots_by_page(part: &Part) -> Box<[u8]> {
    let pages: u32 = REGIONS.iter().map(|(_, pages)| pages).sum();
    let mut slots = vec![0; pages as usize];
    for (number, slot) in (1..).zip(part.slots()) {
        if let Some(page) = page_of(slot.base) {
            slots[page] = number;
        }
    }
    slots.into()
}

/// The outputs of TIM1 that a part's board wires, all low.
fn pulse_pins(part: &Part) -> Vec<(TimerOutput, &'static Signal, bool)> {
    let signals = Sled::carrying(part).into_iter().flat_map(Sled::signals);
    signals
        .filter_map(|signal| match signal.role {
            Role::TimerOutput(output) if output.timer == 1 => Some((output, signal, false)),
            _ => None,
        })
        .collect()
}

/// The register block of one of rsemu's devices.
///
/// # Panics
/// If the device has none; all devices used here have one.
pub(crate) fn registers_of(device: &dyn Device) -> Arc<dyn MemOps> {
    let region = device.region("regs").or_else(|| device.region(""));
    match region.as_ref().map(|region| region.kind()) {
        Some(RegionKind::Io(registers)) => Arc::clone(registers),
        _ => panic!("{} has no register block", device.class().name),
    }
}

/// Brings a device of the emulator into the state of another one of its kind.
pub(crate) fn transfer(from: &dyn Device, to: &dyn Device) {
    carry(from, to).expect("a device reads the state that one of its kind has written");
}

fn carry(from: &dyn Device, to: &dyn Device) -> Result<(), rsemu::Error> {
    const PATH: &str = "device";
    let mut writer = StateWriter::new(MachineShape::new());
    from.save(&mut writer.chunk(PATH, from.class().name, 0)?)?;
    let bytes = writer.to_vec()?;
    let (_, _, state) = StateReader::new(&bytes)?.load_raw(PATH)?;
    let mut reader = ChunkReader::new(state);
    to.load(&mut reader)?;
    reader.end()
}

pub(crate) fn read_word(registers: &dyn MemOps, offset: u32) -> Option<u32> {
    let mut bytes = [0; 4];
    registers
        .read(u64::from(offset), &mut bytes, MemAttrs::DEFAULT)
        .ok()
        .map(|()| u32::from_le_bytes(bytes))
}

pub(crate) fn write_word(registers: &dyn MemOps, offset: u32, value: u32) {
    // The write is refused only if the register does not exist.
    let _ = registers.write(u64::from(offset), &value.to_le_bytes(), MemAttrs::DEFAULT);
}

/// True if the program has connected the peripheral of this role to the pin that the board
/// wires it to.
fn routed(ports: &[gpio::Port], sled: Option<&Sled>, role: Role) -> bool {
    let signal: Option<&Signal> = sled.and_then(|sled| sled.wired_as(role));
    signal.is_some_and(|signal| {
        ports[signal.pin.port_index()].routed(signal.pin.number, signal.alternate)
    })
}
