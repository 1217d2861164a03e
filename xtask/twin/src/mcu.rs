//! One microcontroller: core, memories and peripherals in step.

use crate::clock::{Cycles, NEVER, Ps};
use crate::flash::TimedFlash;
use crate::image::Image;
use crate::part::{Part, Pin};
use crate::peripheral::{
    CanLink, Oscillators, Peripherals, PinChange, Ram, ResetCause, SharedBus, UartByte, lock,
};
use crate::statistics::{Load, Observer, Switch};
use crate::window::{Shared, Window};
use can_bus::{ClockRate, NodeId, SimDuration, SimTime};
use rsemu::core::device::{Device, ResetKind};
use rsemu::core::space::{AddressSpace, RamStore, Region, RomStore, RomWrite};
use rsemu::cpu::arm::v7m::sys::Exception;
use rsemu::cpu::arm::v7m::{ArmV7m, Config};
use std::sync::Arc;

/// Cycles that the emulated core charges for stacking beyond the architected entry of 12
/// and return of 10 (Cortex-M4 processor manual 3.9.2): its eight memory accesses, which
/// on the part run at the same time as the vector fetch.
const STACKING: Cycles = 8;
const ENTRY: Cycles = 12;
const RETURN: Cycles = 10;
const CHAIN: Cycles = 6;
/// IT[7:2] and IT[1:0] in xPSR.
const IT_STATE: u32 = 0x3F << 10 | 3 << 25;
/// Words of floating-point state that a return restores, one cycle each.
const FP_WORDS: Cycles = 17;

/// What surrounds a microcontroller on its board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Clock at OSC_IN, Hz, or `None` when nothing is connected.
    pub external_clock: Option<u32>,
    /// Error of the external clock, parts in 10^9, positive is fast.
    pub crystal_ppb: i32,
    /// Error of the internal RC oscillator, parts in 10^9.
    pub rc_ppb: i32,
    /// When its power comes up.
    pub power_on: SimTime,
    /// What reading the flash costs.
    pub flash: FlashTiming,
}

/// What reading the flash costs the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlashTiming {
    /// Nothing: the cycles of the processor manual, zero wait states.
    #[default]
    Immediate,
    /// The wait states that the program set, softened by prefetch and caches as it
    /// enabled them.
    WaitStates,
}

impl Default for Board {
    /// The clock of the Nucleo-F446RE, exact, on from the beginning.
    fn default() -> Self {
        Self {
            external_clock: Some(parts::Sled::F446.external_hz),
            crystal_ppb: 0,
            rc_ppb: 0,
            power_on: SimTime::from_ticks(0),
            flash: FlashTiming::default(),
        }
    }
}

/// What a core is seen to do, in the order in which it does it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// It executed the instruction at this address.
    Executed(u32),
    /// It began with this exception; what it did before is interrupted.
    Entered(u16),
    /// It ended an exception and began with this one.
    Chained(u16),
    /// It ended an exception and goes on with what that had interrupted.
    Returned,
    /// It was reset: nothing that was in hand goes on.
    Reset,
}

/// Called with everything that a core does.
pub type Trace = Box<dyn FnMut(Seen) + Send>;

/// A running microcontroller.
pub struct Mcu {
    image: Arc<Image>,
    core: ArmV7m,
    shared: Arc<Shared>,
    /// Only with [`FlashTiming::WaitStates`].
    flash: Option<Arc<TimedFlash>>,
    memories: Vec<Ram>,
    node: Option<NodeId>,
    now: Cycles,
    lines: [u32; 4],
    generation: u32,
    asleep: bool,
    locked: bool,
    held: bool,
    /// The sleeping core has to look whether it wakes.
    poke: bool,
    observer: Observer,
    trace: Option<Trace>,
    resets: Vec<(SimTime, ResetCause)>,
}

impl std::fmt::Debug for Mcu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mcu")
            .field("part", &self.image.part())
            .field("now", &self.now)
            .field("asleep", &self.asleep)
            .field("registers", &self.core.regs())
            .finish_non_exhaustive()
    }
}

impl Mcu {
    /// Powers a microcontroller with `image` in its flash up; with `bus`, its CAN
    /// controller is a node there.
    ///
    /// # Panics
    /// Never for the two parts: their memory maps are consistent.
    #[must_use]
    pub fn new(image: Arc<Image>, board: &Board, bus: Option<&SharedBus>) -> Self {
        Self::build(image, board, bus).expect("the parts' memory maps are consistent")
    }

    fn build(
        image: Arc<Image>,
        board: &Board,
        bus: Option<&SharedBus>,
    ) -> Result<Self, rsemu::Error> {
        let part = image.part();
        let link = bus.map(|bus| {
            let rate = ClockRate::new(part.hsi.hz).with_offset_ppb(board.rc_ppb);
            CanLink {
                node: lock(bus).add_bxcan(part, rate),
                bus: Arc::clone(bus),
            }
        });
        let node = link.as_ref().map(|link| link.node);
        let memories: Vec<_> = part
            .ram
            .iter()
            .map(|memory| Ram {
                base: memory.base,
                store: Arc::new(RamStore::new(u64::from(memory.size))),
                dma: memory.dma,
            })
            .collect();
        let oscillators = Oscillators {
            hse_hz: board.external_clock.map(u64::from),
            crystal_ppb: i64::from(board.crystal_ppb),
            rc_ppb: i64::from(board.rc_ppb),
        };
        let contents: Arc<[u8]> = Arc::from(image.flash());
        let flash = match board.flash {
            FlashTiming::Immediate => None,
            FlashTiming::WaitStates => Some(Arc::new(TimedFlash::new(part, contents.clone()))),
        };
        let peripherals = Peripherals::new(
            part,
            oscillators,
            board.power_on.as_ticks(),
            link,
            contents,
            memories.clone(),
        )?;
        let shared = Arc::new(Shared::new(peripherals));
        let space = address_space(&image, flash.as_ref(), &memories, &shared)?;
        let config = Config::CORTEX_M4F
            .with_priority_bits(part.priority_bits)
            .with_reset_vtor(part.flash.base);
        let core = ArmV7m::new(config);
        core.attach_space(Arc::new(space));
        Ok(Self {
            image,
            core,
            shared,
            flash,
            memories,
            node,
            now: 0,
            lines: [0; 4],
            generation: 0,
            asleep: false,
            locked: false,
            held: false,
            poke: false,
            observer: Observer::default(),
            trace: None,
            resets: vec![(board.power_on, ResetCause::PowerOn)],
        })
    }

    /// The program it runs.
    #[must_use]
    pub fn image(&self) -> &Arc<Image> {
        &self.image
    }

    /// Its node on the bus.
    #[must_use]
    pub fn node(&self) -> Option<NodeId> {
        self.node
    }

    /// How far it has come.
    #[must_use]
    pub fn now(&self) -> SimTime {
        SimTime::from_ticks(self.time(self.now))
    }

    /// Core cycles since power-on.
    #[must_use]
    pub fn cycles(&self) -> u64 {
        self.now
    }

    fn time(&self, cycle: Cycles) -> Ps {
        lock(&self.shared.peripherals).clock().time(cycle)
    }

    /// Rate of the core clock, Hz, as its oscillator makes it nominally.
    #[must_use]
    pub fn core_hz(&self) -> u64 {
        lock(&self.shared.peripherals).clock().hertz()
    }

    /// Runs up to `until`, past it by at most an instruction. Returns earlier when the
    /// program wrote to the CAN controller and its own horizon there has come nearer.
    pub fn run_until(&mut self, until: SimTime) {
        let mut limit = self.limit(until);
        loop {
            if self.now >= self.shared.attention() {
                let generation = self.generation;
                let written = self.synchronise();
                if generation != self.generation {
                    limit = self.limit(until);
                }
                if written {
                    let horizon = lock(&self.shared.peripherals).can_horizon();
                    limit = limit.min(self.limit(horizon.min(until)).max(self.now));
                }
            }
            if self.now >= limit {
                break;
            }
            if self.stands_still() {
                self.skip(limit);
            } else {
                self.step();
            }
        }
        self.check_core();
    }

    /// Runs for a span of time.
    pub fn run_for(&mut self, span: SimDuration) {
        let until = self.now() + span;
        while self.now() < until {
            self.run_until(until);
        }
    }

    /// Executes single instructions until the next one stands at `address`, or `budget`
    /// cycles are over. Whether it got there.
    pub fn run_to(&mut self, address: u32, budget: u64) -> bool {
        let end = self.now.saturating_add(budget);
        while self.now < end {
            if self.now >= self.shared.attention() {
                self.synchronise();
            }
            if self.stands_still() {
                self.skip(end);
            } else {
                if self.core.pc() == address && !self.core.reset_pending() {
                    return true;
                }
                self.step();
            }
        }
        false
    }

    fn limit(&self, until: SimTime) -> Cycles {
        lock(&self.shared.peripherals)
            .clock()
            .cycle_from(until.as_ticks())
    }

    /// Whether only an event makes it go on.
    fn stands_still(&self) -> bool {
        self.held || self.locked || (self.asleep && !self.poke)
    }

    /// When it next does anything by itself: now while awake, at its next event while it
    /// sleeps, `None` when nothing is due.
    #[must_use]
    pub fn next_wake(&self) -> Option<SimTime> {
        if !self.stands_still() || self.shared.attention() == 0 {
            return Some(self.now());
        }
        let at = self.shared.attention().min(self.systick_wrap());
        (at != NEVER).then(|| SimTime::from_ticks(self.time(at)))
    }

    /// Applies what the peripherals have come to. True when the program has written to
    /// the CAN controller since.
    fn synchronise(&mut self) -> bool {
        let shared = Arc::clone(&self.shared);
        let mut peripherals = lock(&shared.peripherals);
        peripherals.catch_up(self.now);
        if let Some(cause) = peripherals.reset_request.take() {
            peripherals.reset(cause, self.now);
            self.restart(cause, peripherals.clock().time(self.now));
        }
        self.generation = peripherals.generation;
        let lines = peripherals.lines;
        self.apply(lines);
        if let Some(flash) = &self.flash {
            flash.set_control(peripherals.flash_control());
        }
        let written = std::mem::take(&mut peripherals.can_written);
        peripherals.attended();
        shared.set_attention(peripherals.next_event());
        written
    }

    fn apply(&mut self, lines: [u32; 4]) {
        for (word, (new, old)) in (0_u16..).zip(lines.iter().zip(self.lines)) {
            let mut changed = new ^ old;
            while changed != 0 {
                let bit = changed.trailing_zeros();
                changed &= changed - 1;
                self.core
                    .set_irq(word * 32 + bit as u16, new >> bit & 1 != 0);
            }
        }
        self.poke |= lines != self.lines;
        self.lines = lines;
    }

    fn restart(&mut self, cause: ResetCause, at: Ps) {
        self.core.set_nmi(false);
        self.core.reset(ResetKind::Cold);
        self.lines = [0; 4];
        self.asleep = false;
        self.locked = false;
        self.observer.abandon();
        if let Some(trace) = &mut self.trace {
            trace(Seen::Reset);
        }
        self.resets.push((SimTime::from_ticks(at), cause));
    }

    /// What only shows when one asks the core: a software reset, a lockup.
    fn check_core(&mut self) {
        if self.core.reset_requested() {
            self.core.clear_reset_request();
            lock(&self.shared.peripherals).reset_request = Some(ResetCause::Software);
            self.shared.set_attention(0);
        }
        self.locked = self.core.is_locked_up();
    }

    /// Lets a core that does nothing stand still until something is due.
    fn skip(&mut self, limit: Cycles) {
        let idle = self.held || self.locked;
        let wrap = self.systick_wrap();
        let to = limit.min(self.shared.attention()).min(wrap).max(self.now);
        let cycles = to - self.now;
        if !idle {
            self.observer.asleep += cycles;
            if wrap != NEVER {
                self.poke = self.core.with_sys(|sys| {
                    let wrapped = sys.tick_systick(cycles) && sys.syst_csr & 2 != 0;
                    if wrapped {
                        sys.set_pending(Exception::SYSTICK, true);
                    }
                    wrapped
                });
            }
        }
        self.now = to;
    }

    /// Cycle at which SysTick interrupts a core that sleeps.
    fn systick_wrap(&self) -> Cycles {
        if self.held || self.locked {
            return NEVER;
        }
        self.core.with_sys(|sys| {
            if sys.syst_csr & 3 != 3 || sys.syst_rvr == 0 {
                return NEVER;
            }
            let left = match sys.syst_cvr & 0x00FF_FFFF {
                0 => u64::from(sys.syst_rvr) + 1,
                count => u64::from(count),
            };
            self.now + left
        })
    }

    /// One step of the core: an instruction, or an exception entry.
    #[inline]
    fn step(&mut self) {
        let at = self.trace.is_some().then(|| self.core.pc());
        self.poke = false;
        self.shared.set_now(self.now);
        if let Some(flash) = &self.flash {
            flash.set_now(self.now);
        }
        let before = self.core.xpsr();
        let used = self.core.step();
        let stall = self.flash.as_ref().map_or(0, |flash| flash.take_stall());
        if stall > 0 {
            self.wait(stall);
        }
        if used > CHAIN {
            if before & IT_STATE != 0 {
                self.stack_it_state(before);
            }
            let switch = self.long_step(used, stall);
            if let Some(at) = at {
                self.show(at, switch);
            }
            return;
        }
        if let Some(at) = at {
            self.show(at, Switch::None);
        }
        self.now += used;
        self.observer.step(self.now, used + stall, 0, Switch::None);
        if used == 1 && self.observer.current() == 0 {
            let asleep = self.core.is_asleep();
            // Having fallen asleep, it looks once whether something is pending already.
            self.poke = asleep && !self.asleep;
            self.asleep = asleep;
        }
    }

    /// After an exception was taken in an IT block: adds what the block has still to decide
    /// to the stacked xPSR. The emulated core leaves it out, and the rest of the block would
    /// run unconditionally after the handler (ARMv7-M manual B1.5.6, PushStack).
    fn stack_it_state(&mut self, before: u32) {
        let registers = self.core.regs();
        let handler = self.image.handler(registers.exception().0);
        if handler.is_none_or(|(address, _)| address != registers.r[15]) {
            return;
        }
        // EXC_RETURN bit 2 says which stack has the frame; its eighth word is xPSR.
        let frame = match registers.r[14] & 4 {
            0 => registers.msp,
            _ => registers.psp,
        };
        let at = frame.wrapping_add(28);
        let stacked = self.memory(at, 4).and_then(|bytes| bytes.try_into().ok());
        if let Some(stacked) = stacked.map(u32::from_le_bytes) {
            self.set_memory(at, &(stacked | before & IT_STATE).to_le_bytes());
        }
    }

    /// The core waited for the flash, and its counters went on.
    fn wait(&mut self, stall: Cycles) {
        self.now += stall;
        self.core.with_sys(|sys| {
            sys.tick_cyccnt(stall);
            if sys.tick_systick(stall) && sys.syst_csr & 2 != 0 {
                sys.set_pending(Exception::SYSTICK, true);
            }
        });
    }

    /// Shows a step to who looks on: an exception is taken instead of an instruction, and
    /// ended by one.
    fn show(&mut self, at: u32, switch: Switch) {
        let Some(trace) = &mut self.trace else { return };
        if !matches!(switch, Switch::Enter(_)) {
            trace(Seen::Executed(at));
        }
        match switch {
            Switch::None => {}
            Switch::Enter(exception) => trace(Seen::Entered(exception)),
            Switch::Chain(exception) => trace(Seen::Chained(exception)),
            Switch::Return => trace(Seen::Returned),
        }
    }

    /// A step long enough to have changed the exception in hand.
    fn long_step(&mut self, used: Cycles, stall: Cycles) -> Switch {
        let registers = self.core.regs();
        let exception = registers.exception().0;
        let current = self.observer.current();
        let restarted = || {
            used > CHAIN
                && self
                    .image
                    .handler(exception)
                    .is_some_and(|(address, _)| address == registers.r[15])
        };
        let switch = if exception == current {
            if exception != 0 && restarted() {
                Switch::Chain(exception)
            } else {
                Switch::None
            }
        } else if exception == 0 {
            Switch::Return
        } else if current == 0 || self.core.with_sys(|sys| sys.is_active(Exception(current))) {
            Switch::Enter(exception)
        } else if exception == self.observer.below() {
            Switch::Return
        } else {
            Switch::Chain(exception)
        };
        let (own, overhead, excess) = match switch {
            Switch::None => (used, 0, 0),
            Switch::Enter(_) => (used.saturating_sub(ENTRY + STACKING), ENTRY, STACKING),
            Switch::Chain(_) => (used - CHAIN, CHAIN, 0),
            Switch::Return => {
                let own = used.saturating_sub(RETURN + STACKING);
                if own > FP_WORDS {
                    (own - FP_WORDS, RETURN + FP_WORDS, STACKING)
                } else {
                    (own, RETURN, STACKING)
                }
            }
        };
        self.now += used - excess;
        if excess > 0 {
            self.core.with_sys(|sys| give_back(sys, excess as u32));
        }
        // What an entry waits for is its vector; else it is the instruction.
        let (own, overhead) = match switch {
            Switch::Enter(_) | Switch::Chain(_) => (own, overhead + stall),
            Switch::None | Switch::Return => (own + stall, overhead),
        };
        self.observer.step(self.now, own, overhead, switch);
        if switch != Switch::None {
            self.asleep = self.core.is_asleep();
        }
        switch
    }

    // -- surroundings ---------------------------------------------------------------

    fn surroundings<R>(&mut self, act: impl FnOnce(&mut Peripherals) -> R) -> R {
        let shared = Arc::clone(&self.shared);
        let mut peripherals = lock(&shared.peripherals);
        peripherals.catch_up(self.now);
        let result = act(&mut peripherals);
        let changed = peripherals.lines != self.lines;
        shared.set_attention(if changed {
            0
        } else {
            shared.attention().min(peripherals.next_event())
        });
        result
    }

    /// Takes the external clock away for good, as a broken wire does. What the part does then
    /// is its clock security system's work; false when that is off, and the part, which
    /// should stand still, goes on from a clock that is not there.
    pub fn lose_external_clock(&mut self) -> bool {
        let interrupts = self.surroundings(Peripherals::lose_external_clock);
        if interrupts {
            self.core.set_nmi(true);
            self.poke = true;
            self.shared.set_attention(0);
        }
        interrupts
    }

    /// Drives a pin from outside from now on, or lets go of it (`None`: its pull resistor
    /// decides).
    pub fn drive_pin(&mut self, pin: Pin, level: Option<bool>) {
        self.surroundings(|p| p.drive_pin(pin, level));
    }

    /// Level of a pin.
    #[must_use]
    pub fn pin(&self, pin: Pin) -> bool {
        lock(&self.shared.peripherals).pin_level(pin)
    }

    /// Puts a 12-bit count on an analogue input (channel number of ADC1) from now on.
    pub fn set_analog(&mut self, channel: usize, count: u16) {
        self.surroundings(|p| p.set_analog(channel, count));
    }

    /// Puts bytes on the receive line of a USART (1..): the first start bit at `start`,
    /// the others behind it without a pause, at `baud` bit/s. They are lost while the pin
    /// is not handed to the USART. Calls come in the order of time.
    pub fn feed_uart(&mut self, usart: u8, bytes: &[u8], start: SimTime, baud: u32) {
        let frame = 10_000_000_000_000 / u64::from(baud.max(1));
        for (k, &byte) in (0_u64..).zip(bytes) {
            let at = start.as_ticks() + k * frame;
            self.surroundings(|p| p.feed_uart(usart, byte, at, baud));
        }
    }

    /// Bytes that left since the last call, in the order in which they ended.
    pub fn drain_uart(&mut self) -> Vec<UartByte> {
        let mut bytes = std::mem::take(&mut lock(&self.shared.peripherals).sent);
        bytes.sort_by_key(|byte| byte.end);
        bytes
    }

    /// Output pins that changed since the last call.
    pub fn drain_pins(&mut self) -> Vec<PinChange> {
        std::mem::take(&mut lock(&self.shared.peripherals).pins)
    }

    /// Takes over the CAN interrupts after the bus moved on.
    pub fn bus_moved(&mut self) {
        let changed = {
            let mut peripherals = lock(&self.shared.peripherals);
            peripherals.read_can_lines();
            peripherals.lines != self.lines
        };
        if changed {
            self.shared.set_attention(0);
        }
    }

    /// Pulls the reset pin: the part stands still with its outputs released.
    pub fn hold_reset(&mut self) {
        self.held = true;
        let shared = Arc::clone(&self.shared);
        lock(&shared.peripherals).reset(ResetCause::Pin, self.now);
        shared.set_attention(0);
    }

    /// Lets the reset pin go: the program starts anew, RAM keeps its contents.
    pub fn release_reset(&mut self) {
        if std::mem::take(&mut self.held) {
            let now = self.now().as_ticks();
            self.restart(ResetCause::Pin, now);
        }
    }

    /// Whether its reset pin is pulled.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.held
    }

    /// Every reset so far, power-on included.
    #[must_use]
    pub fn resets(&self) -> &[(SimTime, ResetCause)] {
        &self.resets
    }

    // -- observation ------------------------------------------------------------------

    /// Reads a peripheral's register as the program would at [`Mcu::now`], with the effects that
    /// reading has; `None` where nothing is mapped. For looking at counters.
    pub fn read_register(&mut self, address: u32) -> Option<u32> {
        self.surroundings(|p| p.read(address).ok())
    }

    /// Whether it sleeps in WFI.
    #[must_use]
    pub fn is_asleep(&self) -> bool {
        self.asleep
    }

    /// Whether it met a fault that no handler could take; only a reset helps.
    #[must_use]
    pub fn is_locked_up(&self) -> bool {
        self.core.is_locked_up()
    }

    /// Address of the next instruction.
    #[must_use]
    pub fn pc(&self) -> u32 {
        self.core.pc()
    }

    /// A core register, 0..=15.
    #[must_use]
    pub fn register(&self, index: u8) -> u32 {
        self.core.reg(index)
    }

    /// Sets a core register, for programs that are started in the middle.
    pub fn set_register(&mut self, index: u8, value: u32) {
        self.core.set_reg(index, value);
    }

    /// The exception being handled; 0 is thread mode.
    #[must_use]
    pub fn exception(&self) -> u16 {
        self.core.current_exception().0
    }

    /// Priority of an exception as its register holds it: lower wins.
    #[must_use]
    pub fn priority(&self, exception: u16) -> i32 {
        self.core
            .with_sys(|sys| sys.priority_of(Exception(exception)))
    }

    /// Accesses that hit nothing: how many, and the last address.
    #[must_use]
    pub fn bus_faults(&self) -> (u64, u32) {
        self.core.bus_faults()
    }

    /// Addresses of peripheral registers that the program touched and that are not
    /// modelled; they read as zero.
    #[must_use]
    pub fn unmodelled(&self) -> Vec<u32> {
        lock(&self.shared.peripherals)
            .unmodelled
            .iter()
            .copied()
            .collect()
    }

    /// Where the cycles went since power-on.
    #[must_use]
    pub fn load(&self) -> Load {
        self.observer.report(&self.image)
    }

    /// Observes everything that the core does from now on, or stops that.
    pub fn set_trace(&mut self, trace: Option<Trace>) {
        self.trace = trace;
    }

    /// Reads memory (RAM or flash); `None` outside.
    #[must_use]
    pub fn memory(&self, address: u32, size: usize) -> Option<Vec<u8>> {
        let flash = self.image.part().flash;
        if flash.contains(address) {
            let start = (address - flash.base) as usize;
            return Some(self.image.flash().get(start..start + size)?.to_vec());
        }
        let mut bytes = vec![0; size];
        self.memories.iter().find_map(|ram| {
            let offset = u64::from(address.checked_sub(ram.base)?);
            ram.store.read_at(offset, &mut bytes).ok()
        })?;
        Some(bytes)
    }

    /// Writes RAM. False outside.
    pub fn set_memory(&mut self, address: u32, bytes: &[u8]) -> bool {
        self.memories.iter().any(|ram| {
            address
                .checked_sub(ram.base)
                .is_some_and(|offset| ram.store.write_at(u64::from(offset), bytes).is_ok())
        })
    }

    /// The part.
    #[must_use]
    pub fn part(&self) -> &'static Part {
        self.image.part()
    }
}

/// Takes cycles back that the core charged too many.
fn give_back(sys: &mut rsemu::cpu::arm::v7m::sys::Sys, excess: u32) {
    if sys.cyccnt_enabled() {
        sys.dwt_cyccnt = sys.dwt_cyccnt.wrapping_sub(excess);
    }
    if sys.syst_csr & 1 != 0 && sys.syst_cvr + excess <= sys.syst_rvr {
        sys.syst_cvr += excess;
    }
}

fn address_space(
    image: &Image,
    timed: Option<&Arc<TimedFlash>>,
    memories: &[Ram],
    shared: &Arc<Shared>,
) -> Result<AddressSpace, rsemu::Error> {
    let part = image.part();
    let space = AddressSpace::new("node", 32);
    {
        let mut map = space.topology();
        let region = Arc::new(match timed {
            Some(timed) => Region::io("flash", u64::from(part.flash.size), timed.clone()),
            None => {
                let flash = Arc::new(RomStore::from_slice(image.flash()));
                Region::rom("flash", flash, RomWrite::Fault)
            }
        });
        map.map(Arc::clone(&region), u64::from(part.flash.base))?;
        // The boot pins alias the flash at zero.
        map.map(region, 0)?;
        for ram in memories {
            map.map(
                Region::ram("ram", Arc::clone(&ram.store)),
                u64::from(ram.base),
            )?;
        }
        let page = part.system_page;
        let mut system = vec![0xFF; 0xC00];
        let at = (page.unique_id - page.base) as usize;
        system[at..at + 12].copy_from_slice(b"furrow-twin\0");
        let at = (page.flash_kib - page.base) as usize;
        system[at..at + 2].copy_from_slice(&((part.flash.size / 1024) as u16).to_le_bytes());
        let system = Arc::new(RomStore::from_slice(&system));
        map.map(
            Region::rom("system", system, RomWrite::Fault),
            u64::from(page.base),
        )?;
        for (base, size) in [(0x4000_0000_u32, 0x2000_0000_u64), (0xE004_2000, 0x400)] {
            let window = Window {
                base,
                shared: Arc::clone(shared),
            };
            map.map(
                Region::io("peripherals", size, Arc::new(window)),
                u64::from(base),
            )?;
        }
    }
    Ok(space)
}
