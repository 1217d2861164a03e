//! The kernels that test the execution-time analysis: the bound of each, and the longest of
//! many emulated runs.

use std::{path::Path, sync::Arc, thread};

use schedulability::{board, results::KernelReport};
use twin::{
    mcu::{Board, FlashTiming, Mcu},
    part::Part,
};
use wcet::{
    analysis::Analysis,
    annotation::Annotations,
    bound::Entry,
    cycles::{Cycles, Model},
    image::{Image, ImageError},
    kernels::{INPUT, NAMES, find, input},
    register::Register,
};
use world::random::{Purpose, Stream};

use super::{Builder, LEAST, Profile, cycles::BUDGET};
use crate::Failure;

/// Why the kernels cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The analysis cannot read their image.
    #[error("the kernels: {0}")]
    Image(#[from] ImageError),
    /// The emulator cannot load their image.
    #[error(transparent)]
    Emulated(twin::image::ImageError),
    /// One of them is missing.
    #[error("the kernels: there is no {name}")]
    Missing {
        /// Its name.
        name: &'static str,
    },
    /// One of them has no bound.
    #[error("the kernels: {name} has no bound: {problem}")]
    NoBound {
        /// Its name.
        name: &'static str,
        /// What the analysis cannot follow.
        problem: String,
    },
    /// A thread of the emulation panicked.
    #[error("the kernels: the emulation broke down")]
    BrokenDown,
    /// One of them ran for longer than its bound.
    #[error(
        "the kernels: {name} takes {} and {} cycles, more than its bounds of {} and {}: the analysis is unsound",
        seen.zero_wait, seen.flashed, bound.zero_wait, bound.flashed
    )]
    Unsound {
        /// Its name.
        name: &'static str,
        /// Its longest run.
        seen: Cycles,
        /// Its bound.
        bound: Cycles,
    },
    /// The program does not reach its waiting place.
    #[error("the kernels do not start")]
    NoStart,
    /// One of them does not return.
    #[error("the kernels do not return")]
    NoReturn,
}

/// Their package, from the root of the workspace.
const PACKAGE: &str = "xtask/wcet/kernels/Cargo.toml";
/// Runs of each kernel under each timing.
const RUNS: u64 = 200;
/// The vector table in front of the kernels, and from offset 0x200 on a start-up that turns the floating-point unit on (CPACR), sets flash latency, prefetch and
/// caches as the board does (FLASH_ACR), and waits.
const VECTORS: [u32; 2] = [INPUT, 0x0800_0201];
const START: [u32; 9] = [
    0x4905_4804,
    0x4805_6001,
    0x6001_4905,
    0xBF00_E7FE,
    0xBF00_BF00,
    0xE000_ED88,
    0x00F0_0000,
    0x4002_3C00,
    0x0000_0705,
];
/// Address of the loop in which it waits. Kernels return there.
const IDLE: u32 = 0x0800_020C;

/// Bounds and runs the kernels.
///
/// # Errors
///
/// They do not build, one of them has no bound, or runs longer than its bound says.
pub fn measure(builder: &Builder) -> Result<Vec<KernelReport>, Failure> {
    let path = builder.file(PACKAGE, "kernels", LEAST, Profile::Release)?;
    let kernels = run_all(builder, &path)?;
    Ok(kernels)
}

fn run_all(builder: &Builder, path: &Path) -> Result<Vec<KernelReport>, super::Error> {
    let image = Image::read(path).map_err(Error::from)?;
    let annotations = Annotations::new(builder.workspace.root());
    let mut analysis = Analysis::new(&image, &annotations, &board::part(parts::Sled::F446));
    let mut kernels = Vec::new();
    for name in NAMES {
        let entry = find(&image, name).ok_or(Error::Missing { name })?;
        let bound = analysis.run_with(entry, Entry::Function, &[(Register::R0, INPUT)]);
        if let Some(problem) = bound.problems.first() {
            let problem = problem.to_string();
            return Err(Error::NoBound { name, problem }.into());
        }
        kernels.push((name, entry, bound.cycles));
    }
    let entries: Vec<u32> = kernels.iter().map(|(_, entry, _)| *entry).collect();
    let memory = Memory::new(&image);
    let run = &|timing| longest(&memory, &entries, timing);
    let [zero, flash] = thread::scope(|scope| {
        let timings = [FlashTiming::Immediate, FlashTiming::WaitStates];
        let handles = timings.map(|timing| scope.spawn(move || run(timing)));
        handles.map(thread::ScopedJoinHandle::join)
    });
    let broken = |_| Error::BrokenDown;
    let (zero, flash) = (zero.map_err(broken)??, flash.map_err(broken)??);
    let seen = zero.into_iter().zip(flash);
    kernels
        .into_iter()
        .zip(seen)
        .map(|((name, _, bound), (zero_wait, flashed))| {
            let seen = Cycles { zero_wait, flashed };
            if Model::ALL.iter().any(|model| seen[*model] > bound[*model]) {
                return Err(Error::Unsound { name, seen, bound }.into());
            }
            Ok(KernelReport {
                name: name.to_owned(),
                bound,
                seen,
            })
        })
        .collect()
}

/// Contents of the memories before a kernel is called.
struct Memory {
    flash: Vec<u8>,
    /// Address and contents.
    ram: Vec<(u32, Vec<u8>)>,
}

impl Memory {
    fn new(image: &Image) -> Self {
        let base = Part::F446.flash.base;
        let mut flash = vec![0xFF; 256 * 1024];
        let mut ram = Vec::new();
        let words = |words: &[u32]| -> Vec<u8> {
            words.iter().flat_map(|word| word.to_le_bytes()).collect()
        };
        let start = [(base, words(&VECTORS)), (base + 0x200, words(&START))];
        let contents = image.contents().map(|(at, bytes)| (at, bytes.to_vec()));
        for (address, bytes) in start.into_iter().chain(contents) {
            let place = address.checked_sub(base).map(|offset| offset as usize);
            match place.and_then(|at| flash.get_mut(at..at + bytes.len())) {
                Some(place) => place.copy_from_slice(&bytes),
                None => ram.push((address, bytes)),
            }
        }
        Self { flash, ram }
    }
}

/// The longest run of each kernel.
fn longest(memory: &Memory, entries: &[u32], flash: FlashTiming) -> Result<Vec<u64>, Error> {
    let image =
        twin::image::Image::from_code(Part::F446, &memory.flash).map_err(Error::Emulated)?;
    let board = Board {
        flash,
        ..Board::default()
    };
    let mut core = Mcu::new(Arc::new(image), &board, None);
    if !core.run_to(IDLE, BUDGET) {
        return Err(Error::NoStart);
    }
    let mut all = Vec::new();
    for &entry in entries {
        let mut random = Stream::new(11, Purpose::Faults);
        let mut longest = 0;
        for run in 0..RUNS {
            for (address, bytes) in &memory.ram {
                core.set_memory(*address, bytes);
            }
            let words = input(|| (random.bits() >> 32) as u32, run);
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            core.set_memory(INPUT, &bytes);
            core.set_register(0, INPUT);
            core.set_register(13, INPUT);
            core.set_register(14, IDLE | 1);
            core.set_register(15, entry);
            core.empty_caches();
            let begin = core.cycles();
            if !core.run_to(IDLE, BUDGET) || core.is_locked_up() {
                return Err(Error::NoReturn);
            }
            longest = longest.max(core.cycles() - begin);
        }
        all.push(longest);
    }
    Ok(all)
}
