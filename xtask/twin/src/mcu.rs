//! One microcontroller: core, memories and peripherals, simulated together.

use crate::clock::{Cycles, NEVER, Ps};
use crate::debugger::{self, Debugger, Ended};
use crate::flash::TimedFlash;
use crate::image::Image;
use crate::part::{Family, Part, Pin};
use crate::peripheral::{
    Burst, CanLink, Oscillators, Peripherals, PinChange, REFERENCE_COUNT, Ram, ResetCause,
    SharedBus, UartByte, lock, transfer,
};
use crate::silicon::Violation;
use crate::statistics::{Load, Observer, Switch, TaskSwitch};
use crate::stops::{Footprint, Probe, Stop, Stops};
use crate::stores::{Bytes, Settings, Watched, reaches_registers};
use crate::window::{Changeable, Shared, Window};
use can_bus::{ClockRate, NodeId, SimDuration, SimTime};
use rsemu::core::device::{Device, ResetKind};
use rsemu::core::space::{AddressSpace, DispatchPolicy, RamStore, Region, RomStore, RomWrite};
use rsemu::cpu::arm::v7m::isa::Cond;
use rsemu::cpu::arm::v7m::sys::Exception;
use rsemu::cpu::arm::v7m::{ArmV7m, Config};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Cycles that the emulated core adds for stacking to the 12 cycles of an exception entry and the
/// 10 of a return (Cortex-M4 processor manual 3.9.2). They are its eight memory accesses, which a
/// real core performs during the vector fetch.
const STACKING: Cycles = 8;
const ENTRY: Cycles = 12;
const RETURN: Cycles = 10;
const CHAIN: Cycles = 6;
/// IT[7:2] and IT[1:0] in xPSR.
const IT_STATE: u32 = 0x3F << 10 | 3 << 25;
/// Words of floating-point state that a return restores, one cycle each.
const FP_WORDS: Cycles = 17;

/// The surroundings of a microcontroller on its board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Clock at OSC_IN, Hz, or `None` when nothing is connected.
    pub external_clock: Option<u32>,
    /// Error of the external clock, parts in 10^9, positive is fast.
    pub crystal_ppb: i32,
    /// Error of the internal RC oscillator, parts in 10^9.
    pub rc_ppb: i32,
    /// Frequency of the watchdog's own RC oscillator (LSI), Hz; `None` for the nominal one.
    pub watchdog_hz: Option<u32>,
    /// When its power supply comes on.
    pub power_on: SimTime,
    /// How long reading the flash takes.
    pub flash: FlashTiming,
}

/// How long accesses to the flash, and to peripherals, take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlashTiming {
    /// No wait states: instructions take the cycles of the processor manual.
    #[default]
    Immediate,
    /// The wait states that the program has set, reduced by prefetch and caches as far as the
    /// program has enabled them. Peripherals have the waits of their buses.
    WaitStates,
    /// The same, with caches that every exception finds empty: whatever ran before it left nothing that
    /// it can use.
    EmptyCaches,
}

impl Default for Board {
    /// The clock of the Nucleo-F446RE without error, powered from the beginning.
    fn default() -> Self {
        Self {
            external_clock: Some(parts::Sled::F446.external_hz),
            crystal_ppb: 0,
            rc_ppb: 0,
            watchdog_hz: None,
            power_on: SimTime::from_ticks(0),
            flash: FlashTiming::default(),
        }
    }
}

/// An action of the core, reported in the order of execution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// It executed the instruction at this address.
    Executed(u32),
    /// It entered this exception, at this time, and preempted what it was executing. The last word is
    /// what it found in `BASEPRI`.
    Entered(u16, SimTime, u8),
    /// It left an exception and entered this one without unstacking (tail-chaining), at this
    /// time. The last word is what the one left in `BASEPRI`, and the other one found there.
    Chained(u16, SimTime, u8),
    /// It returned from an exception to the code that this one had preempted, and left this word in
    /// `BASEPRI`.
    Returned(u8),
    /// A watched word of memory was written: by whom, its address, and what it holds since.
    Stored(Storer, u32, u32),
    /// The instruction at this address wrote to this register of the system control space, and changed
    /// by that which interrupts are enabled, their priorities, or the vector table.
    Rearranged(u32, u32),
    /// A stream or channel of a DMA controller, both counted as in the part's manual, has moved an
    /// item, at this time, from this address.
    Moved {
        /// The controller, from 1.
        controller: u8,
        /// Its stream (F4, from 0) or channel (F3, from 1).
        unit: u8,
        /// When.
        at: SimTime,
        /// The address that it read.
        from: u32,
    },
    /// It was reset: no exception is active any more.
    Reset,
}

/// Who writes to memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storer {
    /// The instruction at this address.
    Instruction(u32),
    /// The core, which saves registers as it enters this exception.
    Entry(u16),
    /// A stream or channel of a DMA controller. Both are counted as in the part's manual.
    Dma {
        /// The controller, from 1.
        controller: u8,
        /// Its stream (F4, from 0) or channel (F3, from 1).
        unit: u8,
    },
}

/// Callback for every action of a core.
pub type Trace = Box<dyn FnMut(Seen) + Send>;

/// An instruction that a core has just executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Executed {
    /// Its address.
    pub at: u32,
    /// Where control has gone.
    pub next: u32,
}

/// Says of each executed instruction by how many cycles it ends later than on the emulated core. `None` is one that
/// was skipped, because its `IT` condition did not hold, or the entry or return of an exception.
pub type Slower = Box<dyn FnMut(Option<Executed>) -> Cycles + Send>;

/// A broken bit of memory.
#[derive(Clone, Copy, Debug)]
struct Stuck {
    address: u32,
    mask: u32,
    high: bool,
}

/// The registers of a core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Registers {
    /// r0 to r15. r13 is the stack pointer in use, r15 the address of the next instruction.
    pub r: [u32; 16],
    /// Flags, IT state and exception number.
    pub xpsr: u32,
    /// The main stack pointer.
    pub msp: u32,
    /// The process stack pointer.
    pub psp: u32,
    /// Masks exceptions with priorities that can be set.
    pub primask: bool,
    /// The priority from which on exceptions are masked.
    pub basepri: u8,
    /// Masks all exceptions but NMI.
    pub faultmask: bool,
    /// Stack and privileges in use.
    pub control: u32,
    /// s0 to s31.
    pub s: [u32; 32],
    /// Flags and modes of the floating-point unit.
    pub fpscr: u32,
}

/// A run that the probe has stopped.
#[derive(Clone, Copy, Debug)]
struct Paused {
    /// The cycle up to which it was to run.
    limit: Cycles,
    /// Whether a step is next.
    steps: bool,
}

/// A running microcontroller.
pub struct Mcu {
    image: Arc<Image>,
    core: ArmV7m,
    /// The contents of the flash, for the core and for its copies.
    rom: Arc<RomStore>,
    shared: Arc<Shared>,
    /// Only with wait states.
    flash: Option<Arc<TimedFlash>>,
    /// Whether every exception finds its caches empty.
    finds_caches_empty: bool,
    memories: Vec<Ram>,
    node: Option<NodeId>,
    now: Cycles,
    lines: [u32; 4],
    generation: u32,
    /// IT state of the code below each active exception.
    it_states: Vec<u32>,
    asleep: bool,
    /// Cycles that SysTick has counted in excess and not yet given back.
    owed: u32,
    locked: bool,
    held: bool,
    /// The supply is below the power-down reset.
    unpowered: bool,
    /// Until when the core waits for the flash, which is being erased or programmed.
    stalled: Cycles,
    /// The core sleeps and must check whether to wake up.
    poke: bool,
    observer: Observer,
    trace: Option<Trace>,
    /// By how much instructions end later than on the emulated core.
    slower: Option<Slower>,
    /// Stores to report with the trace.
    watched: Option<Watched>,
    probe: Option<Box<Probe>>,
    /// Where it goes on after a stop of the probe.
    paused: Option<Paused>,
    debugger: Option<Debugger>,
    /// A debugger has enabled halting debug (C_DEBUGEN).
    debugged: bool,
    stuck: Option<Stuck>,
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
    /// Powers up a microcontroller with `image` in its flash. With `bus`, its CAN controller
    /// becomes a node on that bus.
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
            watchdog_hz: u64::from(board.watchdog_hz.unwrap_or(part.lsi.hz)),
        };
        let contents: Arc<[u8]> = Arc::from(image.flash());
        let flash = match board.flash {
            FlashTiming::Immediate => None,
            FlashTiming::WaitStates | FlashTiming::EmptyCaches => {
                Some(Arc::new(TimedFlash::new(part, contents.clone())))
            }
        };
        let peripherals = Peripherals::new(
            part,
            oscillators,
            board.power_on.as_ticks(),
            link,
            contents,
            memories.clone(),
        )?;
        let shared = Arc::new(Shared::new(peripherals, flash.is_some()));
        let rom = Arc::new(RomStore::from_slice(image.flash()));
        let core = core(
            part,
            address_space(part, &rom, flash.as_ref(), &memories, &shared)?,
        );
        Ok(Self {
            image,
            core,
            rom,
            shared,
            flash,
            finds_caches_empty: board.flash == FlashTiming::EmptyCaches,
            memories,
            node,
            now: 0,
            lines: [0; 4],
            generation: 0,
            it_states: Vec::new(),
            asleep: false,
            owed: 0,
            locked: false,
            held: false,
            unpowered: false,
            stalled: 0,
            poke: false,
            observer: Observer::default(),
            trace: None,
            slower: None,
            watched: None,
            probe: None,
            paused: None,
            debugger: None,
            debugged: false,
            stuck: None,
            resets: vec![(board.power_on, ResetCause::PowerOn)],
        })
    }

    /// A microcontroller in the same state, which becomes the same node of `bus`, a copy of this one's
    /// bus. Traces and watched stores stay behind.
    ///
    /// # Panics
    /// Never: what could be built once can be built again.
    #[must_use]
    pub fn copy(&self, bus: Option<&SharedBus>) -> Self {
        let memories: Vec<Ram> = self.memories.iter().map(Ram::copy).collect();
        let link = bus.zip(self.node).map(|(bus, node)| CanLink {
            bus: Arc::clone(bus),
            node,
        });
        let peripherals = lock(&self.shared.peripherals).copy(link, memories.clone());
        let shared = Arc::new(self.shared.copy(peripherals));
        let flash = self.flash.as_ref().map(|flash| Arc::new(flash.copy()));
        let space = address_space(self.part(), &self.rom, flash.as_ref(), &memories, &shared);
        let core = core(self.part(), space.expect("it was built before"));
        transfer(&self.core, &core);
        Self {
            image: Arc::clone(&self.image),
            core,
            rom: Arc::clone(&self.rom),
            shared,
            flash,
            memories,
            it_states: self.it_states.clone(),
            observer: self.observer.clone(),
            trace: None,
            slower: None,
            watched: None,
            probe: self.probe.clone(),
            debugger: self.debugger.clone(),
            resets: self.resets.clone(),
            ..*self
        }
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

    /// The time up to which it has run.
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

    /// Nominal frequency of the core clock in Hz, without the error of its oscillator.
    #[must_use]
    pub fn core_hz(&self) -> u64 {
        lock(&self.shared.peripherals).clock().hertz()
    }

    /// The highest rate that the core clock has had, Hz: that of a node in operation. One that is starting,
    /// or is held in reset, has a slower one.
    #[must_use]
    pub fn operating_hz(&self) -> u64 {
        lock(&self.shared.peripherals).clock().fastest()
    }

    /// Runs until `until` and past it by at most one instruction. Returns earlier if the program
    /// wrote to the CAN controller and the horizon of this node has thereby moved to an earlier
    /// time, or where [`Mcu::stop_at`] stops it. Then [`Mcu::stopped`] says so, and the next call goes on to the
    /// time of this one.
    pub fn run_until(&mut self, until: SimTime) {
        let mut limit = match self.paused.take() {
            Some(Paused { limit, steps }) => {
                if steps {
                    self.step();
                }
                limit
            }
            None => self.limit(until),
        };
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
            let steps = !self.stands_still();
            if self.probe.is_some() && self.stops_here(steps) {
                // What has been written says nothing about the next instruction, which may stop it again.
                let steps = steps && !matches!(self.stopped_by(), Some(Stop::Written(_)));
                self.paused = Some(Paused { limit, steps });
                return;
            }
            if steps {
                self.step();
            } else {
                self.skip(limit);
            }
        }
        self.check_core();
    }

    /// Lets a debugger stop it from now on, and count its steps: instructions and exception entries.
    pub fn attach_probe(&mut self) {
        let flash = self.image.part().flash.size as usize;
        self.probe = Some(Box::new(Probe::new(flash)));
        lock(&self.shared.peripherals).notes_writes = true;
    }

    /// Takes the debugger away. The run goes on.
    pub fn detach_probe(&mut self) {
        self.probe = None;
        lock(&self.shared.peripherals).notes_writes = false;
    }

    /// It stops there from now on, if a probe is attached.
    pub fn stop_at(&mut self, stops: Stops) {
        if let Some(probe) = &mut self.probe {
            probe.set_stops(stops);
        }
    }

    /// Why it stands still in the middle of a run, if it does. Only [`Mcu::run_until`] lets it go on.
    #[must_use]
    pub fn stopped(&self) -> Option<Stop> {
        self.paused?;
        self.stopped_by()
    }

    fn stopped_by(&self) -> Option<Stop> {
        self.probe.as_ref()?.stop
    }

    /// The steps that it has carried out since the probe was attached.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.probe.as_ref().map_or(0, |probe| probe.steps)
    }

    /// What it has passed since the last call, if a probe is attached.
    pub fn take_footprint(&mut self) -> Option<Footprint> {
        self.probe.as_mut().map(|probe| probe.take_footprint())
    }

    /// Whether the probe stops it before its next step, or while it has none.
    fn stops_here(&mut self, steps: bool) -> bool {
        let Some(mut probe) = self.probe.take() else {
            return false;
        };
        let limit = |time| self.limit(time);
        let mut stops = probe.stops_at_write();
        if !stops && steps {
            stops = self.stops_before_instruction(&mut probe);
            stops |= probe.stops_before_step(self.now, self.generation, limit);
        }
        self.probe = Some(probe);
        stops
    }

    fn stops_before_instruction(&self, probe: &mut Probe) -> bool {
        if self.core.reset_pending() {
            return false;
        }
        let at = self.core.pc();
        let offset = at.wrapping_sub(self.image.part().flash.base) as usize;
        let code = || code(&self.image, &self.memories, at);
        let access = probe.decoder().access(&self.core, offset, code);
        probe.stops_before(at, access)
    }

    /// Runs for a span of time.
    pub fn run_for(&mut self, span: SimDuration) {
        let until = self.now() + span;
        while self.now() < until {
            self.run_until(until);
        }
    }

    /// Executes single instructions until the program counter is at `address` or `budget` cycles
    /// have passed. True if it got to the address.
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

    /// True if the core executes nothing until the next event.
    fn stands_still(&self) -> bool {
        self.is_held()
            || self.locked
            || self.is_halted()
            || self.is_stalled()
            || (self.asleep && !self.poke)
    }

    /// True while the core waits for the flash.
    fn is_stalled(&self) -> bool {
        self.now < self.stalled
    }

    /// The next time at which it acts: now while awake, its next event while asleep, `None` if no
    /// event is due.
    #[must_use]
    pub fn next_wake(&self) -> Option<SimTime> {
        if !self.stands_still() || self.shared.attention() == 0 {
            return Some(self.now());
        }
        let at = self.shared.attention().min(self.systick_wrap());
        (at != NEVER).then(|| SimTime::from_ticks(self.time(at)))
    }

    /// Applies the effects of the peripherals on the core. True if the program has written to the
    /// CAN controller since the last call.
    fn synchronise(&mut self) -> bool {
        let shared = Arc::clone(&self.shared);
        let mut peripherals = lock(&shared.peripherals);
        peripherals.catch_up(self.now);
        if let Some(cause) = peripherals.reset_request.take() {
            peripherals.reset(cause, self.now);
            self.restart(cause, peripherals.clock().time(self.now));
        }
        self.generation = peripherals.generation;
        let stalled = peripherals.stalled_until();
        self.stalled = if stalled == NEVER { 0 } else { stalled };
        let lines = peripherals.lines;
        self.apply(lines);
        if let Some(flash) = &self.flash {
            flash.set_control(peripherals.flash_control());
        }
        let written = std::mem::take(&mut peripherals.can_written);
        let stored = std::mem::take(&mut peripherals.written);
        let reached = std::mem::take(&mut peripherals.reached);
        let moved = std::mem::take(&mut peripherals.moved);
        let clock = peripherals.clock();
        let moved = moved.into_iter().map(|(controller, unit, at, from)| {
            let at = SimTime::from_ticks(clock.time(at));
            (controller, unit, at, from)
        });
        let moved: Vec<_> = moved.collect();
        peripherals.attended();
        shared.set_attention(peripherals.next_event());
        if let Some(probe) = &mut self.probe {
            for bytes in stored {
                probe.wrote(bytes);
            }
        }
        for (controller, unit, word) in reached {
            self.show_transfer(controller, unit, word);
        }
        for (controller, unit, at, from) in moved {
            let (controller, unit) = self.unit(controller, unit);
            if let Some(trace) = &mut self.trace {
                trace(Seen::Moved {
                    controller,
                    unit,
                    at,
                    from,
                });
            }
        }
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
        self.owed = 0;
        self.it_states.clear();
        self.locked = false;
        self.observer.abandon(self.now);
        if let Some(trace) = &mut self.trace {
            trace(Seen::Reset);
        }
        self.resets.push((SimTime::from_ticks(at), cause));
    }

    /// Checks for requests that the core does not announce: software reset and lockup.
    fn check_core(&mut self) {
        if self.core.reset_requested() {
            self.core.clear_reset_request();
            lock(&self.shared.peripherals).reset_request = Some(ResetCause::Software);
            self.shared.set_attention(0);
        }
        self.locked = self.core.is_locked_up();
    }

    /// Skips the time until the next event while the core executes nothing.
    fn skip(&mut self, limit: Cycles) {
        let idle = self.is_held() || self.locked || self.is_halted();
        let wrap = self.systick_wrap();
        let to = limit.min(self.shared.attention()).min(wrap).max(self.now);
        let cycles = to - self.now;
        if !idle {
            if !self.is_stalled() {
                self.observer.asleep += cycles;
            }
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

    /// Cycle at which SysTick interrupts a sleeping core.
    fn systick_wrap(&self) -> Cycles {
        if self.is_held() || self.locked || self.is_halted() {
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
        let at = (self.trace.is_some() || self.slower.is_some()).then(|| self.core.pc());
        self.poke = false;
        if let Some(probe) = &mut self.probe {
            probe.steps += 1;
        }
        self.shared.set_now(self.now);
        if self.debugged && (self.serve_debugger_call() || self.load_debug_control()) {
            return;
        }
        if let Some(flash) = &self.flash {
            flash.set_now(self.now);
        }
        let before = self.core.xpsr();
        let fpscr = self.core.fpscr();
        let store = at.and_then(|at| self.next_store(at));
        let settings = store.filter(|store| reaches_registers(*store));
        let settings = settings.map(|_| self.core.with_sys(|sys| Settings::of(sys)));
        let used = self.core.step();
        if self.stuck.is_some() {
            self.hold_stuck_bit();
        }
        let stall =
            self.flash.as_ref().map_or(0, |flash| flash.take_stall()) + self.shared.take_stall();
        if stall > 0 {
            self.wait(stall);
        }
        if used > CHAIN {
            let switch = self.long_step(used, stall);
            self.keep_it_state(before, switch);
            if let Some(flash) = self.flash.as_ref().filter(|_| switch != Switch::None) {
                flash.switch();
            }
            if matches!(switch, Switch::Enter(_) | Switch::Chain(_)) {
                if self.finds_caches_empty {
                    self.empty_caches();
                }
                // Until the handler's first float instruction has stored it, FPSCR belongs to the
                // code below. The emulated core overwrites it at once, so that a comparison just
                // before the exception would lose its flags (ARMv7-M manual B1.5.7,
                // ExecuteFPCheck).
                self.core.set_fpscr(fpscr);
            }
            if matches!(switch, Switch::Enter(_)) && self.probe.is_some() {
                let frame = self.frame();
                if let Some(probe) = &mut self.probe {
                    probe.wrote(frame);
                }
            }
            if let Some(at) = at {
                self.slow_down(at, before, switch);
                self.show(at, switch);
                self.show_stores(at, store, settings, switch);
            }
            return;
        }
        self.now += used;
        self.observer.step(self.now, used + stall, 0, Switch::None);
        if let Some(at) = at {
            self.slow_down(at, before, Switch::None);
            self.show(at, Switch::None);
            self.show_stores(at, store, settings, Switch::None);
        }
        if used == 1 && self.observer.current() == 0 {
            let asleep = self.core.is_asleep();
            // A core that has just fallen asleep checks once for interrupts that are already
            // pending.
            self.poke = asleep && !self.asleep;
            self.asleep = asleep;
        }
    }

    /// Empties the caches of the flash, if it has a timing.
    pub fn empty_caches(&self) {
        if let Some(flash) = &self.flash {
            flash.empty();
        }
    }

    /// Lets the debugger answer the instruction at the program counter if that is a semihosting
    /// call. It takes no time: a debugger halts the core, and its counters with it.
    fn serve_debugger_call(&mut self) -> bool {
        let at = self.core.pc();
        if self.next_code() == Some(debugger::CALL)
            && let Some(mut debugger) = self.debugger.take()
        {
            let (operation, parameter) = (self.core.reg(0), self.core.reg(1));
            let result = debugger.answer(self, operation, parameter);
            self.core.set_reg(0, result);
            self.core.set_pc(at.wrapping_add(2));
            self.debugger = Some(debugger);
            return true;
        }
        false
    }

    /// Carries out a load of the debug control register: the emulated core has no debug unit, and
    /// its own load would read zero. It knows the 16-bit load with a constant offset, outside IT
    /// blocks. It takes no time.
    fn load_debug_control(&mut self) -> bool {
        let Some((target, base, offset)) = self.next_code().and_then(debugger::load) else {
            return false;
        };
        let found = self.core.reg(base).wrapping_add(offset) == debugger::CONTROL;
        if found {
            self.core.set_reg(target, debugger::ENABLED);
            let next = self.core.pc().wrapping_add(2);
            self.core.set_pc(next);
        }
        found
    }

    /// The first halfword of the instruction at the program counter; `None` outside flash, and while
    /// a reset is pending.
    fn next_code(&self) -> Option<u16> {
        let at = self.core.pc();
        let offset = at.wrapping_sub(self.image.part().flash.base) as usize;
        let code = self.image.flash().get(offset..)?.first_chunk()?;
        (!self.core.reset_pending()).then_some(u16::from_le_bytes(*code))
    }

    /// True once the program has told its debugger that it has ended: the core stands still.
    fn is_halted(&self) -> bool {
        self.ended().is_some()
    }

    /// Keeps the IT state of code that an exception preempts. Two things are wrong in the emulated core:
    /// it does not stack that state, and a return that is itself in an IT block (`it eq`, `popeq`)
    /// advances the state that it has just restored.
    fn keep_it_state(&mut self, before: u32, switch: Switch) {
        let state = before & IT_STATE;
        match switch {
            Switch::Enter(_) => {
                self.it_states.push(state);
                if state != 0 {
                    self.stack_it_state(before);
                }
            }
            Switch::Return => {
                let below = self.it_states.pop().unwrap_or(0);
                if state != 0 {
                    let xpsr = self.core.xpsr();
                    self.core.set_xpsr(xpsr & !IT_STATE | below);
                }
            }
            Switch::Chain(_) | Switch::None => {}
        }
    }

    /// After an exception inside an IT block, adds the remaining IT state to the stacked xPSR. The
    /// emulated core omits it; without it the rest of the block would run unconditionally after the
    /// handler (ARMv7-M manual B1.5.6, PushStack).
    fn stack_it_state(&mut self, before: u32) {
        let registers = self.core.regs();
        let handler = self.image.handler(registers.exception().0);
        if handler.is_none_or(|(address, _)| address != registers.r[15]) {
            return;
        }
        // Bit 2 of EXC_RETURN selects the stack that holds the frame. The eighth word of the frame
        // is xPSR.
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

    /// The core waited for the flash or a peripheral bus while its counters continued.
    fn wait(&mut self, stall: Cycles) {
        self.now += stall;
        self.core.with_sys(|sys| {
            sys.tick_cyccnt(stall);
            if sys.tick_systick(stall) && sys.syst_csr & 2 != 0 {
                sys.set_pending(Exception::SYSTICK, true);
            }
        });
    }

    /// Lets the instruction at `at` end later, where the core is slower than the emulated one. `before` is the
    /// status in which it began.
    #[inline]
    fn slow_down(&mut self, at: u32, before: u32, switch: Switch) {
        let Some(slower) = &mut self.slower else {
            return;
        };
        let executed = (switch == Switch::None && !is_skipped(before)).then(|| Executed {
            at,
            next: self.core.pc(),
        });
        let later = slower(executed);
        if later > 0 {
            self.wait(later);
            self.observer.step(self.now, later, 0, Switch::None);
        }
    }

    /// Reports a step to the trace. A step executes an instruction or enters an exception; an
    /// exception ends with an instruction.
    fn show(&mut self, at: u32, switch: Switch) {
        let now = match switch {
            Switch::Enter(_) | Switch::Chain(_) => SimTime::from_ticks(self.time(self.now)),
            Switch::None | Switch::Return => SimTime::from_ticks(0),
        };
        let Some(trace) = &mut self.trace else { return };
        let mask = || self.core.regs().basepri;
        if !matches!(switch, Switch::Enter(_)) {
            trace(Seen::Executed(at));
        }
        match switch {
            Switch::None => {}
            Switch::Enter(exception) => trace(Seen::Entered(exception, now, mask())),
            Switch::Chain(exception) => trace(Seen::Chained(exception, now, mask())),
            Switch::Return => trace(Seen::Returned(mask())),
        }
    }

    /// The bytes that the instruction at `at` will store, if stores are watched.
    #[inline]
    fn next_store(&mut self, at: u32) -> Option<Bytes> {
        let Self {
            image,
            core,
            watched,
            memories,
            ..
        } = self;
        let watched = watched.as_mut()?;
        let offset = at.wrapping_sub(image.part().flash.base) as usize;
        watched.store(core, offset, || code(image, memories, at))
    }

    /// Reports the stores of a step: those of the instruction at `at`, or of the registers that the core
    /// saves instead of executing it.
    #[inline]
    fn show_stores(
        &mut self,
        at: u32,
        store: Option<Bytes>,
        settings: Option<Settings>,
        switch: Switch,
    ) {
        if self.watched.is_none() {
            return;
        }
        match (switch, store) {
            (Switch::Enter(exception), _) => {
                let frame = self.frame();
                self.show_words(Storer::Entry(exception), frame);
            }
            (_, Some(store)) => {
                self.show_words(Storer::Instruction(at), store);
                let changed = settings
                    .is_some_and(|before| self.core.with_sys(|sys| Settings::of(sys) != before));
                if let Some(trace) = self.trace.as_mut().filter(|_| changed) {
                    trace(Seen::Rearranged(at, store.0));
                }
            }
            (_, None) => {}
        }
    }

    /// The bytes in which the core has just saved registers as it entered an exception. Bit 4 of
    /// `EXC_RETURN` is clear if there is room for floating-point registers among them, bit 2 selects the
    /// stack (DDI 0403 B1.5.8).
    fn frame(&self) -> Bytes {
        let registers = self.core.regs();
        let (link, size) = (registers.r[14], 8 * 4);
        let size = if link & 1 << 4 == 0 {
            size + 18 * 4
        } else {
            size
        };
        let first = match link & 4 {
            0 => registers.msp,
            _ => registers.psp,
        };
        (first, first.saturating_add(size - 1))
    }

    fn show_words(&mut self, by: Storer, bytes: Bytes) {
        let Some(watched) = &self.watched else { return };
        let words: Vec<u32> = watched.words(bytes).collect();
        for at in words {
            let held = self.word(at);
            if let Some(trace) = &mut self.trace {
                trace(Seen::Stored(by, at, held));
            }
        }
    }

    /// Reports a transfer to a watched word.
    fn show_transfer(&mut self, controller: usize, unit: usize, at: u32) {
        let (controller, unit) = self.unit(controller, unit);
        let by = Storer::Dma { controller, unit };
        let held = self.word(at);
        if let Some(trace) = &mut self.trace {
            trace(Seen::Stored(by, at, held));
        }
    }

    /// A DMA controller and its stream or channel as the part's manual counts them.
    fn unit(&self, controller: usize, unit: usize) -> (u8, u8) {
        let first = match self.part().family {
            Family::F4 => 0,
            Family::F3 => 1,
        };
        (controller as u8 + 1, unit as u8 + first)
    }

    fn word(&self, at: u32) -> u32 {
        let bytes = self.memory(at, 4).and_then(|bytes| bytes.try_into().ok());
        bytes.map_or(0, u32::from_le_bytes)
    }

    /// Handles a step that took long enough to have changed the active exception.
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
            let excess = excess as u32;
            self.owed = self.core.with_sys(|sys| give_back(sys, excess, self.owed));
        }
        // Flash wait states of an entry belong to the vector fetch, otherwise to the instruction.
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

    /// Stops the external clock for good, as a broken wire does. True if the clock security system
    /// handles the failure. False if that is off: a real part would then stop, but the model
    /// continues as if the clock still ran.
    pub fn lose_external_clock(&mut self) -> bool {
        let interrupts = self.surroundings(Peripherals::lose_external_clock);
        if interrupts {
            self.core.set_nmi(true);
            self.poke = true;
            self.shared.set_attention(0);
        }
        interrupts
    }

    /// A clock of `hertz` comes to OSC_IN.
    pub fn find_external_clock(&mut self, hertz: u32) {
        self.surroundings(|p| p.find_external_clock(hertz));
    }

    /// The error of the internal RC oscillator changes, parts in 10^9: temperature and supply do
    /// that.
    pub fn set_internal_error(&mut self, ppb: i32) {
        self.surroundings(|p| p.set_internal_error(ppb));
        // The core's rate may have changed.
        self.shared.set_attention(0);
    }

    /// The watchdog's oscillator has this frequency from now on, Hz.
    pub fn set_watchdog_clock(&mut self, hertz: u32) {
        self.surroundings(|p| p.set_watchdog_clock(hertz));
    }

    /// Whether the part's PLL locks when it is switched on from now on. A part whose PLL does not
    /// is broken.
    pub fn set_pll_locks(&mut self, locks: bool) {
        self.surroundings(|p| p.set_pll_locks(locks));
    }

    /// From now on the CAN controller inverts these bits of the first data word of each frame that
    /// it receives: it is broken.
    pub fn corrupt_reception(&mut self, mask: u32) {
        self.surroundings(|p| p.corrupt_reception(mask));
    }

    /// From now on the CAN controller does not leave the bus when the program asks it to initialise:
    /// it is broken. Only a reset takes it off the bus. With `unlocked` it also takes a bit timing
    /// over while it is on the bus.
    pub fn jam_controller(&mut self, unlocked: bool) {
        self.surroundings(|p| p.jam_controller(unlocked));
    }

    /// Plugs a transceiver in at the CAN pins, or takes it away. One is there at first. Without it
    /// the node is on no bus, and the pull resistor of the receive pin sets its level.
    pub fn set_transceiver(&mut self, present: bool) {
        self.surroundings(|p| p.set_transceiver(present));
    }

    /// Whether the timer that measures the external clock gets its edges. It does at first.
    pub fn set_clock_measured(&mut self, measured: bool) {
        self.surroundings(|p| p.set_measured(measured));
    }

    /// Sets the supply of the part, mV; 3300 at first. The converter measures against it, and the
    /// voltage detector compares it. Below the power-down reset the part stops with its outputs
    /// released and forgets everything; above the power-on reset the program starts again.
    pub fn set_supply(&mut self, millivolts: u16) {
        let thresholds = self.part().supply;
        if millivolts < thresholds.reset_mv && !self.unpowered {
            self.unpowered = true;
            self.hold(ResetCause::PowerOn);
            self.forget();
        }
        self.surroundings(|p| p.set_supply(millivolts));
        if millivolts >= thresholds.start_mv && self.unpowered {
            self.unpowered = false;
            if !self.held {
                self.release(ResetCause::PowerOn);
            }
        }
    }

    /// From now on bit `bit` of the word of memory at `address` keeps the level `high`, whatever is
    /// written to it: the memory is broken.
    pub fn stick_memory(&mut self, address: u32, bit: u32, high: bool) {
        self.stuck = Some(Stuck {
            address,
            mask: 1 << (bit % 32),
            high,
        });
        self.hold_stuck_bit();
    }

    /// The broken bit of memory takes its level.
    fn hold_stuck_bit(&self) {
        let Some(Stuck {
            address,
            mask,
            high,
        }) = self.stuck
        else {
            return;
        };
        for ram in &self.memories {
            let offset = u64::from(address.wrapping_sub(ram.base));
            let mut word = [0; 4];
            if ram.store.read_at(offset, &mut word).is_ok() {
                let value = u32::from_le_bytes(word);
                let held = if high { value | mask } else { value & !mask };
                if held != value {
                    let _ = ram.store.write_at(offset, &held.to_le_bytes());
                }
            }
        }
    }

    /// Attaches a debugger, which answers the program's semihosting calls from now on: it passes
    /// `command_line` and notes the end. Without one such a call is a hard fault, as on a board.
    pub fn attach_debugger(&mut self, command_line: &str) {
        self.enable_debug();
        self.debugger = Some(Debugger::new(command_line));
    }

    /// A debugger enables halting debug: the program reads C_DEBUGEN as set from now on. Only a
    /// power cycle of a real part clears it again.
    pub const fn enable_debug(&mut self) {
        self.debugged = true;
    }

    /// How the program under a debugger ended, once it has. The core stands still from then on.
    #[must_use]
    pub fn ended(&self) -> Option<&Ended> {
        self.debugger.as_ref()?.ended.as_ref()
    }

    /// Writes a peripheral's register as a debugger does. False if no peripheral is mapped there.
    pub fn write_register(&mut self, address: u32, value: u32) -> bool {
        self.surroundings(|p| p.write(address, value).is_ok())
    }

    /// Whether the program has started the watchdog.
    #[must_use]
    pub fn watchdog_runs(&self) -> bool {
        lock(&self.shared.peripherals).watchdog_runs()
    }

    /// Drives a pin from outside from now on. With `None` it is no longer driven, and its pull
    /// resistor sets the level.
    pub fn drive_pin(&mut self, pin: Pin, level: Option<bool>) {
        self.surroundings(|p| p.drive_pin(pin, level));
    }

    /// Level of a pin.
    #[must_use]
    pub fn pin(&self, pin: Pin) -> bool {
        lock(&self.shared.peripherals).pin_level(pin)
    }

    /// Sets an analogue input (channel of ADC1) to a 12-bit reading from now on.
    pub fn set_analog(&mut self, channel: usize, count: u16) {
        self.surroundings(|p| p.set_analog(channel, count));
    }

    /// Sends bytes to the receive line of a USART (numbered from 1) at `baud` bit/s. The first
    /// start bit is at `start`, the others follow without a pause. Bytes are lost while the pin is
    /// not assigned to the USART. Calls must be in order of time.
    pub fn feed_uart(&mut self, usart: u8, bytes: &[u8], start: SimTime, baud: u32) {
        let frame = 10_000_000_000_000 / u64::from(baud.max(1));
        for (k, &byte) in (0_u64..).zip(bytes) {
            let at = start.as_ticks() + k * frame;
            self.surroundings(|p| p.feed_uart(usart, byte, at, baud));
        }
    }

    /// Bytes transmitted since the last call, in the order in which they ended.
    pub fn drain_uart(&mut self) -> Vec<UartByte> {
        let mut bytes = std::mem::take(&mut lock(&self.shared.peripherals).sent);
        bytes.sort_by_key(|byte| byte.end);
        bytes
    }

    /// Output pins that changed since the last call.
    pub fn drain_pins(&mut self) -> Vec<PinChange> {
        std::mem::take(&mut lock(&self.shared.peripherals).pins)
    }

    /// Conversions that were begun since the last call.
    pub fn drain_bursts(&mut self) -> Vec<Burst> {
        std::mem::take(&mut lock(&self.shared.peripherals).bursts)
    }

    /// Updates the CAN interrupts after the bus has been simulated further.
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

    /// Pulls the reset pin low: the part stops with its outputs released.
    pub fn hold_reset(&mut self) {
        self.held = true;
        self.hold(ResetCause::Pin);
    }

    /// Releases the reset pin: the program starts anew, RAM keeps its contents.
    pub fn release_reset(&mut self) {
        if std::mem::take(&mut self.held) && !self.unpowered {
            self.release(ResetCause::Pin);
        }
    }

    /// The part is in reset from now on.
    fn hold(&mut self, cause: ResetCause) {
        let shared = Arc::clone(&self.shared);
        lock(&shared.peripherals).reset(cause, self.now);
        shared.set_attention(0);
    }

    /// The part leaves the reset that [`Mcu::hold`] began.
    fn release(&mut self, cause: ResetCause) {
        self.hold(cause);
        let now = self.now().as_ticks();
        self.restart(cause, now);
    }

    /// What is left in a RAM without supply is not known. A pattern that is neither zero nor a
    /// record of the program's shows who relies on it.
    fn forget(&self) {
        for ram in &self.memories {
            let size = ram.store.len() as usize;
            let pattern: Vec<u8> = (0..size).map(|at| (at * 37 + 0x5A) as u8).collect();
            let _ = ram.store.write_at(0, &pattern);
        }
    }

    /// True while its reset pin is held low, or its supply is too low.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.held || self.unpowered
    }

    /// Every reset so far, power-on included.
    #[must_use]
    pub fn resets(&self) -> &[(SimTime, ResetCause)] {
        &self.resets
    }

    // -- observation ------------------------------------------------------------------

    /// Reads a peripheral's register as the program would at [`Mcu::now`], including the side
    /// effects of a read. `None` if no peripheral is mapped there. Meant for reading counters.
    pub fn read_register(&mut self, address: u32) -> Option<u32> {
        self.surroundings(|p| p.read(address).ok())
    }

    /// True while it sleeps in WFI.
    #[must_use]
    pub fn is_asleep(&self) -> bool {
        self.asleep
    }

    /// True if the core is in lockup, a fault that no handler can take. Only a reset ends it.
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

    /// Sets a core register, for programs that do not start at their reset handler.
    pub fn set_register(&mut self, index: u8, value: u32) {
        self.core.set_reg(index, value);
    }

    /// All registers of the core.
    #[must_use]
    pub fn registers(&self) -> Registers {
        let core = self.core.regs();
        let mut s = [0; 32];
        for (value, index) in s.iter_mut().zip(0..) {
            *value = self.core.s(index);
        }
        Registers {
            r: core.r,
            xpsr: core.xpsr,
            msp: core.msp,
            psp: core.psp,
            primask: core.primask,
            basepri: core.basepri,
            faultmask: core.faultmask,
            control: core.control,
            s,
            fpscr: self.core.fpscr(),
        }
    }

    /// Sets all registers of the core. Of a stack pointer that is given twice, r13 counts if it differs from the
    /// present one.
    pub fn set_registers(&mut self, registers: &Registers) {
        let mut core = self.core.regs();
        let (before, process) = (core.r[13], core.r[13] == core.psp && core.msp != core.psp);
        core.r = registers.r;
        core.xpsr = registers.xpsr;
        core.msp = registers.msp;
        core.psp = registers.psp;
        if registers.r[13] != before {
            let stack = if process {
                &mut core.psp
            } else {
                &mut core.msp
            };
            *stack = registers.r[13];
        }
        core.primask = registers.primask;
        core.basepri = registers.basepri;
        core.faultmask = registers.faultmask;
        core.control = registers.control;
        self.core.set_regs(core);
        for (value, index) in registers.s.iter().zip(0..) {
            self.core.set_s(index, *value);
        }
        self.core.set_fpscr(registers.fpscr);
    }

    /// Reads a word of the system control space (0xE000_E000 to 0xE000_EFFF) as a debugger does, without side
    /// effects. `None` for addresses without a register.
    #[must_use]
    pub fn system_word(&self, address: u32) -> Option<u32> {
        self.core.with_sys(|sys| sys.read_word(address, true))
    }

    /// The exception being handled; 0 is thread mode.
    #[must_use]
    pub fn exception(&self) -> u16 {
        self.core.current_exception().0
    }

    /// Priority of an exception as its register holds it. A lower value is more urgent.
    #[must_use]
    pub fn priority(&self, exception: u16) -> i32 {
        self.core
            .with_sys(|sys| sys.priority_of(Exception(exception)))
    }

    /// Makes an interrupt pending, as the program does through the interrupt controller. It is named by its
    /// exception number, 16 or more.
    pub fn pend(&mut self, exception: u16) {
        self.core
            .with_sys(|sys| sys.set_pending(Exception(exception), true));
        self.poke = true;
        self.shared.set_attention(0);
    }

    /// Registers without a model read as zeros and as ones in turn from now on, so that a program which waits
    /// for a bit goes on. Those of peripherals without a model do so, too; an access to one is no bus fault any
    /// more.
    pub fn let_unmodelled_change(&mut self) {
        lock(&self.shared.peripherals).let_unmodelled_change();
    }

    /// Accesses to unmapped addresses: their number, and the last address.
    #[must_use]
    pub fn bus_faults(&self) -> (u64, u32) {
        self.core.bus_faults()
    }

    /// Addresses of peripheral registers that the program accessed but the model lacks. They read
    /// as zero.
    #[must_use]
    pub fn unmodelled(&self) -> Vec<u32> {
        lock(&self.shared.peripherals)
            .unmodelled
            .iter()
            .copied()
            .collect()
    }

    /// What the program did so far that the part's documents do not allow, oldest first.
    #[must_use]
    pub fn violations(&self) -> Vec<Violation> {
        lock(&self.shared.peripherals).violations().to_vec()
    }

    /// The first entry of [`Mcu::violations`].
    #[must_use]
    pub fn first_violation(&self) -> Option<Violation> {
        lock(&self.shared.peripherals).violations().first().cloned()
    }

    /// How the cycles since power-on were spent.
    #[must_use]
    pub fn load(&self) -> Load {
        self.observer.report(&self.image)
    }

    /// Notes from now on what the core executes, for [`Mcu::drain_switches`].
    pub fn note_switches(&mut self) {
        self.observer.note_switches();
    }

    /// What the core began to execute since the last call, in order of time. Call it before the clock
    /// has changed twice: the times are those of the present rate.
    pub fn drain_switches(&mut self) -> Vec<TaskSwitch> {
        let switches = self.observer.take_switches();
        let peripherals = lock(&self.shared.peripherals);
        let clock = peripherals.clock();
        let switch = |(cycle, exception)| TaskSwitch {
            at: SimTime::from_ticks(clock.time(cycle)),
            exception,
        };
        switches.into_iter().map(switch).collect()
    }

    /// The name of the handler of an exception: for interrupts that of the vector, and `None` for one
    /// that the program does not handle.
    #[must_use]
    pub fn handler_name(&self, exception: u16) -> Option<String> {
        self.image.handler(exception).map(|(_, name)| name)
    }

    /// Calls `trace` for every action of the core from now on; `None` ends this.
    pub fn set_trace(&mut self, trace: Option<Trace>) {
        self.trace = trace;
    }

    /// Lets the core take longer from now on than the emulated one; `None` ends this.
    pub fn set_slower(&mut self, slower: Option<Slower>) {
        self.slower = slower;
    }

    /// Reports to the trace, from now on, each store to one of these words of memory, and each one that
    /// changes which interrupts are enabled, their priorities, or the vector table. Words are named by
    /// their first address.
    pub fn watch_stores(&mut self, words: &BTreeSet<u32>) {
        let flash = self.image.part().flash.size as usize;
        self.watched = Some(Watched::new(words, flash));
        lock(&self.shared.peripherals).watched = words.iter().copied().collect();
    }

    /// Reports every transfer by DMA to the trace from now on.
    pub fn watch_transfers(&mut self) {
        lock(&self.shared.peripherals).notes_transfers = true;
    }

    /// Reads memory (RAM or flash); `None` outside these.
    #[must_use]
    pub fn memory(&self, address: u32, size: usize) -> Option<Vec<u8>> {
        let flash = self.image.part().flash;
        if flash.contains(address) {
            let offset = address - flash.base;
            let start = offset as usize;
            let peripherals = lock(&self.shared.peripherals);
            let changed = peripherals.changed_flash(offset, size);
            let image = || self.image.flash().get(start..start + size);
            return changed.or_else(image).map(<[u8]>::to_vec);
        }
        let mut bytes = vec![0; size];
        self.memories.iter().find_map(|ram| {
            let offset = u64::from(address.checked_sub(ram.base)?);
            ram.store.read_at(offset, &mut bytes).ok()
        })?;
        Some(bytes)
    }

    /// Writes RAM. False for addresses outside it.
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

/// Whether the `IT` state in this status lets the next instruction be skipped (ARMv7-M manual A7.3.2: its
/// upper half, bits 15 to 12 of the status, is the condition).
fn is_skipped(status: u32) -> bool {
    status & IT_STATE != 0 && !Cond((status >> 12 & 0xF) as u8).passes(status)
}

/// The halfwords at `at` and behind it, in flash or RAM.
fn code(image: &Image, memories: &[Ram], at: u32) -> Option<[u16; 2]> {
    let mut bytes = [0; 4];
    let flash = image.part().flash;
    if flash.contains(at) {
        let rest = image.flash().get((at - flash.base) as usize..)?;
        let there = rest.len().min(4);
        bytes[..there].copy_from_slice(&rest[..there]);
    } else {
        memories.iter().find_map(|ram| {
            let offset = u64::from(at.checked_sub(ram.base)?);
            ram.store.read_at(offset, &mut bytes).ok()
        })?;
    }
    let [a, b, c, d] = bytes;
    Some([u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])])
}

/// Subtracts cycles that the core counted in excess. SysTick gets those that it is `owed` by one entry
/// before, too; the result is what it is owed then. If it has wrapped within them it gets none now: it
/// would wrap again and tick twice.
fn give_back(sys: &mut rsemu::cpu::arm::v7m::sys::Sys, excess: u32, owed: u32) -> u32 {
    if sys.cyccnt_enabled() {
        sys.dwt_cyccnt = sys.dwt_cyccnt.wrapping_sub(excess);
    }
    if sys.syst_csr & 1 == 0 {
        return 0;
    }
    let due = owed.min(excess) + excess;
    if sys.syst_cvr == 0 || sys.syst_cvr + due > sys.syst_rvr {
        return due;
    }
    sys.syst_cvr += due;
    0
}

/// The core of a part, at its power-on.
fn core(part: &Part, space: AddressSpace) -> ArmV7m {
    let config = Config::CORTEX_M4F
        .with_priority_bits(part.priority_bits)
        .with_reset_vtor(part.flash.base);
    let core = ArmV7m::new(config);
    core.attach_space(Arc::new(space));
    core
}

/// A table of 33 kB finds the flash, and the RAM of the larger part, without a search for the address. Smaller pages would
/// find all memories so, but a debugger keeps many copies of each node.
const DISPATCH: DispatchPolicy = DispatchPolicy::Dense {
    page_bits: 16,
    cover: 0x2002_0000,
};

fn address_space(
    part: &Part,
    rom: &Arc<RomStore>,
    timed: Option<&Arc<TimedFlash>>,
    memories: &[Ram],
    shared: &Arc<Shared>,
) -> Result<AddressSpace, rsemu::Error> {
    let space = AddressSpace::new("node", 32).with_dispatch(DISPATCH);
    {
        let mut map = space.topology();
        let region = Arc::new(match timed {
            Some(timed) => Region::io("flash", u64::from(part.flash.size), timed.clone()),
            None => Region::rom("flash", Arc::clone(rom), RomWrite::Fault),
        });
        map.map(Arc::clone(&region), u64::from(part.flash.base))?;
        // The boot pins map the flash to address zero.
        map.map(region, 0)?;
        let (begin, size) = lock(&shared.peripherals).changeable();
        if size > 0 {
            let changeable = Changeable {
                begin,
                shared: Arc::clone(shared),
                timed: timed.map(Arc::clone),
            };
            let region = Arc::new(Region::io("missions", size as u64, Arc::new(changeable)));
            map.map(Arc::clone(&region), u64::from(part.flash.base + begin))?;
            map.map(region, u64::from(begin))?;
        }
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
        let at = (page.reference - page.base) as usize;
        system[at..at + 2].copy_from_slice(&REFERENCE_COUNT.to_le_bytes());
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
