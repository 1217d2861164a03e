//! What gdb does with a node: registers, memory, breakpoints, and running in both directions.

use std::{collections::BTreeSet, convert::Infallible};

use gdbstub::{
    arch::Arch,
    common::Signal,
    stub::SingleThreadStopReason,
    target::{
        Target, TargetError, TargetResult,
        ext::{
            base::{
                BaseOps,
                reverse_exec::{
                    ReplayLogPosition, ReverseCont, ReverseContOps, ReverseStep, ReverseStepOps,
                },
                single_register_access::{SingleRegisterAccess, SingleRegisterAccessOps},
                singlethread::{
                    SingleThreadBase, SingleThreadRangeStepping, SingleThreadRangeSteppingOps,
                    SingleThreadResume, SingleThreadResumeOps, SingleThreadSingleStep,
                    SingleThreadSingleStepOps,
                },
            },
            breakpoints::{
                Breakpoints, BreakpointsOps, HwBreakpoint, HwBreakpointOps, HwWatchpoint,
                HwWatchpointOps, SwBreakpoint, SwBreakpointOps, WatchKind,
            },
            memory_map::{MemoryMap, MemoryMapOps},
            monitor_cmd::{ConsoleOutput, MonitorCmd, MonitorCmdOps},
        },
    },
};
use twin::{
    mcu::Mcu,
    replay::{Halt, Replay},
    stops::{Stop, Stops, Watch, Watched},
};
use vehicle_model::{NodeIndex, Vehicle};

use super::{
    journal::Journal,
    monitor,
    registers::{CortexM, File, Number},
    until::{Until, Watcher},
};

/// Why the node stands still, as gdb is told.
pub(super) type Reason = SingleThreadStopReason<u32>;

const LOCKUP: &str = "The core is in lockup, a fault that no handler can take: reverse-stepi goes to its last instruction.";

/// Handlers that may run between two steps of the code below before the second one is given up.
const HANDLERS: usize = 100;

/// The peripherals, and the system control space with the debug block behind it.
const PERIPHERALS: (u32, u32) = (0x4000_0000, 0x2000_0000);
const SYSTEM: (u32, u32) = (0xE000_0000, 0x0010_0000);
/// Registers of the core in it (DDI 0403 B3.2).
const CORE_BLOCK: std::ops::Range<u32> = 0xE000_E000..0xE000_F000;

/// What gdb wants the node to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Request {
    Continue,
    Step,
    /// Steps as long as the address of the next instruction is from the first to before the second one.
    StepRange(u32, u32),
    ContinueBack,
    StepBack,
}

/// A node under gdb, with the vehicle around it.
pub(super) struct Machine<'v> {
    pub(super) replay: Replay<Journal>,
    pub(super) vehicle: &'v Vehicle,
    pub(super) node: NodeIndex,
    software: BTreeSet<u32>,
    hardware: BTreeSet<u32>,
    watches: BTreeSet<Watch>,
    request: Option<Request>,
    /// Where the next run is to halt.
    pub(super) until: Option<Until>,
    watcher: Option<Watcher<'v>>,
    /// Exception and address of the code that a step is to carry out after the handlers.
    preempted: Option<(u16, u32)>,
    /// Lines for gdb's console.
    lines: Vec<String>,
}

impl<'v> Machine<'v> {
    /// A node at the beginning of a run.
    pub(super) fn new(replay: Replay<Journal>, vehicle: &'v Vehicle, node: NodeIndex) -> Self {
        Self {
            replay,
            vehicle,
            node,
            software: BTreeSet::new(),
            hardware: BTreeSet::new(),
            watches: BTreeSet::new(),
            request: None,
            until: None,
            watcher: None,
            preempted: None,
            lines: Vec::new(),
        }
    }

    /// The lines for gdb's console since the last call.
    pub(super) fn take_lines(&mut self) -> Vec<String> {
        let mut lines = self.replay.companion_mut().take_fresh();
        lines.append(&mut self.lines);
        lines
    }

    /// Runs up to a place without a debugger.
    pub(super) fn run_until(
        &mut self,
        until: Until,
        shown: &mut dyn FnMut(&Replay<Journal>),
    ) -> Halt {
        self.until = Some(until);
        let halt = self.go_on(&mut |replay| {
            shown(replay);
            false
        });
        self.until = None;
        halt
    }

    /// Does what gdb wants, until the node stands still, or `called` says that gdb has something to say. `None`
    /// if that is not done yet.
    pub(super) fn carry_out(&mut self, called: &mut dyn FnMut() -> bool) -> Option<Reason> {
        let request = self.request?;
        let was_locked = self.replay.mcu().is_locked_up();
        let mut pause = |replay: &Replay<Journal>| {
            let locked = !was_locked && replay.mcu().is_locked_up();
            called() || locked || replay.companion().has_fresh()
        };
        let halt = match request {
            Request::Continue => self.go_on(&mut pause),
            Request::Step => self.step_over_handlers(&mut pause),
            Request::StepRange(first, end) => self.step_range(first, end, &mut pause),
            Request::ContinueBack => self.go_back(&mut pause),
            Request::StepBack => self.step_back_over_handlers(&mut pause),
        };
        if halt == Halt::Interrupted && !was_locked && self.replay.mcu().is_locked_up() {
            self.give_up();
            self.lines.push(LOCKUP.into());
            return Some(Reason::Signal(Signal::SIGSEGV));
        }
        if halt == Halt::Interrupted {
            return None;
        }
        self.give_up();
        Some(self.reason(halt))
    }

    /// Gives up what gdb wanted.
    pub(super) fn give_up(&mut self) {
        self.request = None;
        self.preempted = None;
        self.watcher = None;
    }

    /// Forgets what gdb has set: another one does not know of it.
    pub(super) fn disarm(&mut self) {
        self.give_up();
        self.software.clear();
        self.hardware.clear();
        self.watches.clear();
        self.until = None;
    }

    fn stops(&self) -> Stops {
        Stops {
            breakpoints: self.software.union(&self.hardware).copied().collect(),
            watches: self.watches.clone(),
            ..Stops::default()
        }
    }

    fn go_on(&mut self, pause: &mut dyn FnMut(&Replay<Journal>) -> bool) -> Halt {
        let mut stops = self.stops();
        let mut watcher = self.watcher.take();
        match self.until.clone() {
            Some(Until::Time(time)) if time > self.replay.mcu().now() => stops.time = Some(time),
            Some(Until::Time(_)) | None => {}
            Some(event) => {
                let (twin, records) = (self.replay.twin(), self.replay.records());
                watcher =
                    watcher.or_else(|| Some(Watcher::new(event, self.vehicle, twin, records)));
            }
        }
        let time = stops.time;
        let mut happened = None;
        let halt = self.replay.forwards(stops, &mut |replay| {
            let paused = pause(replay);
            if let Some(watcher) = &mut watcher {
                happened = watcher.happened(replay.twin(), replay.records());
            }
            // A node that sleeps for long is left where the time is.
            let over = time.is_some_and(|time| replay.twin().now() >= time);
            paused || over || happened.is_some()
        });
        self.watcher = watcher;
        if let Some(at) = happened {
            self.until = None;
            self.watcher = None;
            // The way back forgets them.
            let mut lines = self.replay.companion_mut().take_fresh();
            self.lines.append(&mut lines);
            return self.replay.go_to(at, &mut |_| false);
        }
        let over = time.is_some_and(|time| self.replay.twin().now() >= time);
        if halt == Halt::Stop(Stop::Time) || halt == Halt::Interrupted && over {
            self.until = None;
            return Halt::Stop(Stop::Time);
        }
        halt
    }

    fn go_back(&mut self, pause: &mut dyn FnMut(&Replay<Journal>) -> bool) -> Halt {
        let now = self.replay.mcu().now();
        let halt = self.replay.backwards(&self.stops(), pause);
        match self.until {
            Some(Until::Time(time))
                if time < now && self.replay.mcu().now() < time && halt != Halt::Interrupted =>
            {
                self.until = None;
                self.replay.go_to(time, &mut |_| false)
            }
            _ => halt,
        }
    }

    /// Carries out the next instruction of the code that runs, with the handlers that come before it.
    fn step_over_handlers(&mut self, pause: &mut dyn FnMut(&Replay<Journal>) -> bool) -> Halt {
        for _ in 0..HANDLERS {
            let (level, at) = match self.preempted.take() {
                Some(preempted) => preempted,
                None => {
                    let from = (self.replay.mcu().exception(), self.replay.mcu().pc());
                    let stops = Stops {
                        step: Some(self.replay.steps() + 1),
                        ..Stops::default()
                    };
                    let halt = self.replay.forwards(stops, pause);
                    if halt != Halt::Stop(Stop::Step) || !self.preempts(from.0) {
                        return halt;
                    }
                    from
                }
            };
            // The instruction comes when the handlers have returned to it.
            while self.replay.mcu().exception() != level {
                let mut stops = self.stops();
                stops.breakpoints.insert(at);
                let halt = self.replay.forwards(stops, pause);
                if halt == Halt::Interrupted {
                    self.preempted = Some((level, at));
                    return halt;
                }
                if halt != Halt::Stop(Stop::Breakpoint) || self.is_breakpoint() {
                    return halt;
                }
            }
        }
        Halt::Stop(Stop::Step)
    }

    /// Steps until the next instruction is outside a range, or at a breakpoint.
    fn step_range(
        &mut self,
        first: u32,
        end: u32,
        pause: &mut dyn FnMut(&Replay<Journal>) -> bool,
    ) -> Halt {
        loop {
            let halt = self.step_over_handlers(pause);
            if halt != Halt::Stop(Stop::Step) || !(first..end).contains(&self.replay.mcu().pc()) {
                return halt;
            }
            if self.is_breakpoint() {
                return Halt::Stop(Stop::Breakpoint);
            }
        }
    }

    /// Goes back behind the instruction before in the code that runs, and the handlers that came after it.
    fn step_back_over_handlers(&mut self, pause: &mut dyn FnMut(&Replay<Journal>) -> bool) -> Halt {
        for _ in 0..HANDLERS {
            let (level, at) = (self.replay.mcu().exception(), self.replay.mcu().pc());
            let here = self.replay.steps();
            let halt = self.replay.step_back();
            if halt != Halt::Stop(Stop::Step) || !self.returns(level, at) {
                return halt;
            }
            while self.replay.mcu().exception() != level {
                let mut stops = self.stops();
                stops.breakpoints.insert(at);
                let halt = self.replay.backwards(&stops, pause);
                if halt == Halt::Interrupted {
                    // Begun anew, since a part of the way is no step.
                    let back = Stops {
                        step: Some(here),
                        ..Stops::default()
                    };
                    self.replay.forwards(back, &mut |_| false);
                    return halt;
                }
                if halt != Halt::Stop(Stop::Breakpoint) || self.is_breakpoint() {
                    return halt;
                }
            }
        }
        Halt::Stop(Stop::Step)
    }

    /// Whether the node is at the beginning of a handler that has just preempted this level.
    fn preempts(&self, level: u16) -> bool {
        let mcu = self.replay.mcu();
        self.begins(mcu.exception(), mcu.pc()) && self.is_above(mcu.exception(), level)
    }

    /// Whether the node is at the end of a handler, and its next step leads back to this level and address.
    fn returns(&self, level: u16, at: u32) -> bool {
        self.is_above(self.replay.mcu().exception(), level) && !self.begins(level, at)
    }

    /// Whether the handler of an exception begins at this address.
    fn begins(&self, exception: u16, at: u32) -> bool {
        let handler = self.replay.mcu().image().handler(exception);
        exception != 0 && handler.is_some_and(|(address, _)| address == at)
    }

    /// Whether one exception may preempt the other; 0 is thread mode.
    fn is_above(&self, one: u16, other: u16) -> bool {
        let priority = |exception| match exception {
            0 => i32::MAX,
            exception => self.replay.mcu().priority(exception),
        };
        priority(one) < priority(other)
    }

    fn is_breakpoint(&self) -> bool {
        let at = self.replay.mcu().pc();
        self.software.contains(&at) || self.hardware.contains(&at)
    }

    fn reason(&mut self, halt: Halt) -> Reason {
        match halt {
            Halt::Stop(Stop::Step) => Reason::DoneStep,
            Halt::Stop(Stop::Time) | Halt::Interrupted => Reason::Signal(Signal::SIGTRAP),
            Halt::Stop(Stop::Breakpoint) if self.software.contains(&self.replay.mcu().pc()) => {
                Reason::SwBreak(())
            }
            Halt::Stop(Stop::Breakpoint) => Reason::HwBreak(()),
            Halt::Stop(Stop::Access(watch) | Stop::Written(watch)) => Reason::Watch {
                tid: (),
                kind: match watch.kind {
                    Watched::Reads => WatchKind::Read,
                    Watched::Writes => WatchKind::Write,
                    Watched::Accesses => WatchKind::ReadWrite,
                },
                addr: watch.first,
            },
            Halt::Beginning => Reason::ReplayLog {
                tid: None,
                pos: ReplayLogPosition::Begin,
            },
            Halt::End => {
                self.lines
                    .push("The run ends here; reverse-continue goes back.".into());
                Reason::ReplayLog {
                    tid: None,
                    pos: ReplayLogPosition::End,
                }
            }
            Halt::Failed(why) => {
                self.lines.push(format!(
                    "{why}. The run cannot go on; reverse-continue goes back."
                ));
                Reason::Signal(Signal::SIGILL)
            }
        }
    }

    /// Reads memory, flash, registers of the core, or those of peripherals. `None` where nothing is.
    fn read(&self, address: u32, size: usize) -> Option<Vec<u8>> {
        let mcu = self.replay.mcu();
        let flash = mcu.part().flash;
        // The boot pins map the flash to address zero.
        let mapped = if address < flash.size {
            address + flash.base
        } else {
            address
        };
        if let Some(bytes) = mcu.memory(mapped, size) {
            return Some(bytes);
        }
        if CORE_BLOCK.contains(&address) {
            return words(address, size, |word| mcu.system_word(word));
        }
        if is_peripheral(address) {
            // A read may have side effects, so it is done on a copy of the whole vehicle.
            let mut copy = self.replay.twin().copy();
            return words(address, size, |word| {
                copy.node_mut(self.node).read_register(word)
            });
        }
        None
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> bool {
        let mcu = self.replay.mcu();
        if !mcu.part().flash.contains(address) && mcu.memory(address, bytes.len()).is_some() {
            return self
                .replay
                .change(|mcu: &mut Mcu| mcu.set_memory(address, bytes));
        }
        let is_register = is_peripheral(address) && address.is_multiple_of(4);
        match <[u8; 4]>::try_from(bytes) {
            Ok(word) if is_register => {
                let word = u32::from_le_bytes(word);
                self.replay.change(|mcu| mcu.write_register(address, word))
            }
            _ => false,
        }
    }

    fn set_registers(&mut self, file: &File) {
        self.replay.change(|mcu| mcu.set_registers(&file.0));
    }
}

fn is_peripheral(address: u32) -> bool {
    address.wrapping_sub(PERIPHERALS.0) < PERIPHERALS.1
}

/// Bytes from words that are read one by one.
fn words(address: u32, size: usize, mut read: impl FnMut(u32) -> Option<u32>) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut word = address & !3;
    let skipped = (address & 3) as usize;
    while bytes.len() < skipped + size {
        bytes.extend(read(word)?.to_le_bytes());
        word = word.checked_add(4)?;
    }
    Some(bytes[skipped..skipped + size].to_vec())
}

impl Target for Machine<'_> {
    type Arch = CortexM;
    type Error = Infallible;

    fn base_ops(&mut self) -> BaseOps<'_, CortexM, Infallible> {
        BaseOps::SingleThread(self)
    }

    fn support_breakpoints(&mut self) -> Option<BreakpointsOps<'_, Self>> {
        Some(self)
    }

    fn support_memory_map(&mut self) -> Option<MemoryMapOps<'_, Self>> {
        Some(self)
    }

    fn support_monitor_cmd(&mut self) -> Option<MonitorCmdOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadBase for Machine<'_> {
    fn read_registers(&mut self, registers: &mut File) -> TargetResult<(), Self> {
        *registers = File(self.replay.mcu().registers());
        Ok(())
    }

    fn write_registers(&mut self, registers: &File) -> TargetResult<(), Self> {
        self.set_registers(registers);
        Ok(())
    }

    fn support_single_register_access(&mut self) -> Option<SingleRegisterAccessOps<'_, (), Self>> {
        Some(self)
    }

    fn read_addrs(&mut self, address: u32, data: &mut [u8]) -> TargetResult<usize, Self> {
        // Memory may end within what gdb asks for.
        let mut sizes = [data.len(), data.len() & !3, 4, 2, 1].into_iter();
        let bytes = sizes.find_map(|size| {
            let fits = 0 < size && size <= data.len();
            fits.then(|| self.read(address, size))?
        });
        let bytes = bytes.ok_or(TargetError::NonFatal)?;
        data[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn write_addrs(&mut self, address: u32, data: &[u8]) -> TargetResult<(), Self> {
        if self.write(address, data) {
            Ok(())
        } else {
            Err(TargetError::NonFatal)
        }
    }

    fn support_resume(&mut self) -> Option<SingleThreadResumeOps<'_, Self>> {
        Some(self)
    }
}

impl SingleRegisterAccess<()> for Machine<'_> {
    fn read_register(
        &mut self,
        (): (),
        number: Number,
        buffer: &mut [u8],
    ) -> TargetResult<usize, Self> {
        let bytes = File(self.replay.mcu().registers()).bytes();
        let bytes = &bytes[number.place()];
        let buffer = buffer.get_mut(..bytes.len()).ok_or(TargetError::NonFatal)?;
        buffer.copy_from_slice(bytes);
        Ok(bytes.len())
    }

    fn write_register(&mut self, (): (), number: Number, value: &[u8]) -> TargetResult<(), Self> {
        let mut bytes = File(self.replay.mcu().registers()).bytes();
        let place = &mut bytes[number.place()];
        if place.len() != value.len() {
            return Err(TargetError::NonFatal);
        }
        place.copy_from_slice(value);
        let file = File::of(&bytes).ok_or(TargetError::NonFatal)?;
        self.set_registers(&file);
        Ok(())
    }
}

impl SingleThreadResume for Machine<'_> {
    fn resume(&mut self, _: Option<Signal>) -> Result<(), Infallible> {
        self.request = Some(Request::Continue);
        Ok(())
    }

    fn support_single_step(&mut self) -> Option<SingleThreadSingleStepOps<'_, Self>> {
        Some(self)
    }

    fn support_range_step(&mut self) -> Option<SingleThreadRangeSteppingOps<'_, Self>> {
        Some(self)
    }

    fn support_reverse_step(&mut self) -> Option<ReverseStepOps<'_, (), Self>> {
        Some(self)
    }

    fn support_reverse_cont(&mut self) -> Option<ReverseContOps<'_, (), Self>> {
        Some(self)
    }
}

impl SingleThreadSingleStep for Machine<'_> {
    fn step(&mut self, _: Option<Signal>) -> Result<(), Infallible> {
        self.request = Some(Request::Step);
        Ok(())
    }
}

impl SingleThreadRangeStepping for Machine<'_> {
    fn resume_range_step(&mut self, first: u32, end: u32) -> Result<(), Infallible> {
        self.request = Some(Request::StepRange(first, end));
        Ok(())
    }
}

impl ReverseStep<()> for Machine<'_> {
    fn reverse_step(&mut self, (): ()) -> Result<(), Infallible> {
        self.request = Some(Request::StepBack);
        Ok(())
    }
}

impl ReverseCont<()> for Machine<'_> {
    fn reverse_cont(&mut self) -> Result<(), Infallible> {
        self.request = Some(Request::ContinueBack);
        Ok(())
    }
}

impl Breakpoints for Machine<'_> {
    fn support_sw_breakpoint(&mut self) -> Option<SwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_breakpoint(&mut self) -> Option<HwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_watchpoint(&mut self) -> Option<HwWatchpointOps<'_, Self>> {
        Some(self)
    }
}

type Kind = <CortexM as Arch>::BreakpointKind;

impl SwBreakpoint for Machine<'_> {
    fn add_sw_breakpoint(&mut self, at: u32, _: Kind) -> TargetResult<bool, Self> {
        self.software.insert(at & !1);
        Ok(true)
    }

    fn remove_sw_breakpoint(&mut self, at: u32, _: Kind) -> TargetResult<bool, Self> {
        Ok(self.software.remove(&(at & !1)))
    }
}

impl HwBreakpoint for Machine<'_> {
    fn add_hw_breakpoint(&mut self, at: u32, _: Kind) -> TargetResult<bool, Self> {
        self.hardware.insert(at & !1);
        Ok(true)
    }

    fn remove_hw_breakpoint(&mut self, at: u32, _: Kind) -> TargetResult<bool, Self> {
        Ok(self.hardware.remove(&(at & !1)))
    }
}

/// The watch that gdb names; `None` for an empty range, or one that goes beyond all addresses.
fn watch(first: u32, length: u32, kind: WatchKind) -> Option<Watch> {
    Some(Watch {
        first,
        last: first.checked_add(length.checked_sub(1)?)?,
        kind: match kind {
            WatchKind::Read => Watched::Reads,
            WatchKind::Write => Watched::Writes,
            WatchKind::ReadWrite => Watched::Accesses,
        },
    })
}

impl HwWatchpoint for Machine<'_> {
    fn add_hw_watchpoint(
        &mut self,
        at: u32,
        length: u32,
        kind: WatchKind,
    ) -> TargetResult<bool, Self> {
        let watch = watch(at, length, kind);
        self.watches.extend(watch);
        Ok(watch.is_some())
    }

    fn remove_hw_watchpoint(
        &mut self,
        at: u32,
        length: u32,
        kind: WatchKind,
    ) -> TargetResult<bool, Self> {
        Ok(watch(at, length, kind).is_some_and(|watch| self.watches.remove(&watch)))
    }
}

impl MemoryMap for Machine<'_> {
    /// Flash is read-only, so gdb uses hardware breakpoints there.
    fn memory_map_xml(
        &self,
        offset: u64,
        length: usize,
        buffer: &mut [u8],
    ) -> TargetResult<usize, Self> {
        let part = self.replay.mcu().part();
        let flash = part.flash;
        let row = |kind: &str, base: u32, size: u32| {
            format!("<memory type=\"{kind}\" start=\"{base:#x}\" length=\"{size:#x}\"/>")
        };
        let mut rows = vec![
            row("rom", 0, flash.size),
            row("rom", flash.base, flash.size),
        ];
        rows.extend(part.ram.iter().map(|ram| row("ram", ram.base, ram.size)));
        rows.extend([PERIPHERALS, SYSTEM].map(|(base, size)| row("ram", base, size)));
        let text = format!("<memory-map>{}</memory-map>", rows.concat());
        let rest = usize::try_from(offset)
            .ok()
            .and_then(|offset| text.as_bytes().get(offset..));
        let rest = rest.unwrap_or_default();
        let size = rest.len().min(length).min(buffer.len());
        buffer[..size].copy_from_slice(&rest[..size]);
        Ok(size)
    }
}

impl MonitorCmd for Machine<'_> {
    fn handle_monitor_cmd(
        &mut self,
        command: &[u8],
        mut out: ConsoleOutput<'_>,
    ) -> Result<(), Infallible> {
        let command = String::from_utf8_lossy(command);
        out.write_raw(monitor::answer(self, &command).as_bytes());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Workspace, build};
    use campaign::agreement::SPAN;
    use can_bus::RecordKind;
    use twin::Twin;
    use world::{Scenario, SimTime};

    /// Where the node is: its steps, its exception and its program counter.
    fn place(machine: &Machine<'_>) -> (u64, u16, u32) {
        let mcu = machine.replay.mcu();
        (mcu.steps(), mcu.exception(), mcu.pc())
    }

    fn ask(machine: &mut Machine<'_>, request: Request) -> Reason {
        machine.request = Some(request);
        loop {
            // The log interrupts a run.
            if let Some(reason) = machine.carry_out(&mut || false) {
                return reason;
            }
            machine.take_lines();
        }
    }

    fn uagv() -> Vehicle {
        let workspace = Workspace::find().unwrap();
        crate::vehicle::find(&workspace, "uagv").unwrap()
    }

    /// The steering node of a run of two seconds, after the first one.
    fn steering(vehicle: &Vehicle) -> Machine<'_> {
        let workspace = Workspace::find().unwrap();
        let nodes: Vec<_> = vehicle.nodes().collect();
        let images = build::read(&build::images(&workspace, vehicle, &nodes).unwrap()).unwrap();
        let scenario = Scenario::find(vehicle, "straight-line").unwrap();
        let twin = Twin::new(vehicle, &scenario, 1, &images).unwrap();
        let node = vehicle.find_node("steering").unwrap();
        let journal = Journal::new(node, images.of(node));
        let end = SimTime::from_ticks(2_000_000_000_000);
        let replay = Replay::new(twin, journal, node, end, SPAN).unwrap();
        let mut machine = Machine::new(replay, vehicle, node);
        machine.until = Some(Until::Time(SimTime::from_ticks(1_000_000_000_000)));
        let reason = ask(&mut machine, Request::Continue);
        assert_eq!(reason, Reason::Signal(Signal::SIGTRAP));
        machine
    }

    #[test]
    fn a_lockup_stops_the_run_once() {
        let vehicle = uagv();
        let mut machine = steering(&vehicle);
        // Nothing can be fetched there, and the fault's handler is masked.
        let mut registers = machine.replay.mcu().registers();
        registers.faultmask = true;
        registers.r[15] = 0x7000_0000;
        machine.set_registers(&File(registers));
        let reason = ask(&mut machine, Request::Continue);
        assert_eq!(reason, Reason::Signal(Signal::SIGSEGV));
        assert!(machine.take_lines().iter().any(|line| line == LOCKUP));
        let ends =
            |reason, wanted| matches!(reason, Reason::ReplayLog { pos, .. } if pos == wanted);
        let reason = ask(&mut machine, Request::Continue);
        assert!(ends(reason, ReplayLogPosition::End), "{reason:?}");
        let reason = ask(&mut machine, Request::ContinueBack);
        assert!(ends(reason, ReplayLogPosition::Begin), "{reason:?}");
        assert!(!machine.replay.mcu().is_locked_up());
    }

    #[test]
    fn breakpoints_go_with_the_gdb_that_set_them() {
        let vehicle = uagv();
        let mut machine = steering(&vehicle);
        machine.hardware.insert(machine.replay.mcu().pc());
        assert_eq!(ask(&mut machine, Request::Continue), Reason::HwBreak(()));
        machine.disarm();
        let reason = ask(&mut machine, Request::Continue);
        assert!(matches!(reason, Reason::ReplayLog { .. }), "{reason:?}");
    }

    #[test]
    fn a_run_halts_where_a_frame_begins() {
        let vehicle = uagv();
        let mut machine = steering(&vehicle);
        let (command, from) = (300, machine.replay.twin().now());
        machine.until = Some(Until::Frame(command));
        let reason = ask(&mut machine, Request::Continue);
        assert_eq!(reason, Reason::Signal(Signal::SIGTRAP));
        assert_eq!(machine.until, None);
        let halted = machine.replay.mcu().now();
        machine.replay.go_to(halted + SPAN, &mut |_| false);
        let begun = machine
            .replay
            .records()
            .iter()
            .find(|record| match &record.kind {
                RecordKind::FrameStart { frame } => {
                    let id = embedded_can::StandardId::new(command).map(embedded_can::Id::from);
                    record.at > from && Some(frame.id()) == id
                }
                _ => false,
            });
        let late = halted.as_ticks() - begun.unwrap().at.as_ticks();
        assert!(late <= 1_001_000_000, "{late} ps");
        // Back in time by the same way as gdb.
        machine.until = Some(Until::Time(from));
        let reason = ask(&mut machine, Request::ContinueBack);
        assert_eq!(reason, Reason::Signal(Signal::SIGTRAP));
        let late = machine.replay.mcu().now().as_ticks() - from.as_ticks();
        assert!(late <= 1_001_000_000, "{late} ps");
    }

    #[test]
    fn steps_pass_the_handlers_in_both_directions() {
        let vehicle = uagv();
        let mut machine = steering(&vehicle);
        // In a handler of low priority, until another one has come between two of its instructions.
        let housekeeping = 16 + 8;
        let (address, _) = machine.replay.mcu().image().handler(housekeeping).unwrap();
        let mut places: Vec<(u64, u16, u32)> = Vec::new();
        let passed = |places: &[(u64, u16, u32)]| {
            let mut pairs = places.windows(2);
            pairs.any(|pair| pair[1].0 > pair[0].0 + 1)
        };
        while !passed(&places) {
            if machine.replay.mcu().exception() != housekeeping {
                places.clear();
                machine.hardware.insert(address);
                assert_eq!(ask(&mut machine, Request::Continue), Reason::HwBreak(()));
                machine.hardware.clear();
            }
            assert_eq!(ask(&mut machine, Request::Step), Reason::DoneStep);
            places.push(place(&machine));
            let old = places.len().saturating_sub(30);
            places.drain(..old);
        }
        for _ in 0..10 {
            assert_eq!(ask(&mut machine, Request::Step), Reason::DoneStep);
            places.push(place(&machine));
        }
        for wanted in places.iter().rev().skip(1) {
            assert_eq!(ask(&mut machine, Request::StepBack), Reason::DoneStep);
            // Before or behind the handlers that come before an instruction, which is the same to gdb.
            let (_, exception, pc) = place(&machine);
            assert_eq!((exception, pc), (wanted.1, wanted.2), "{places:?}");
        }
    }
}
