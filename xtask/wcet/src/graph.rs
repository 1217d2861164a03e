//! The control-flow graph of one function, rebuilt from its instructions.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::image::Image;
use super::instruction::{Flow, Instruction, NotCode, advance_it, decode};
use super::register::{Register, RegisterSet};
use rsemu::cpu::arm::v7m::isa::Insn;

/// Targets of indirect jumps found so far, by the jump's address.
pub type Targets = HashMap<u32, BTreeSet<u32>>;

/// Which functions return, as far as this was asked. The code after a call that never returns
/// does not belong to the path of the call; following it would add loops that do not exist.
#[derive(Debug, Default)]
pub struct Returning(HashMap<u32, bool>);

impl Returning {
    /// Whether the function at `entry` may return; true if that is unknown.
    pub fn ask(&mut self, image: &Image, entry: u32) -> bool {
        if let Some(&known) = self.0.get(&entry) {
            return known;
        }
        if is_panic(&image.name(entry)) {
            self.0.insert(entry, false);
            return false;
        }
        // A recursive function returns only if a path without the recursive call does.
        self.0.insert(entry, false);
        let returns = self.search(image, entry);
        self.0.insert(entry, returns);
        returns
    }

    fn search(&mut self, image: &Image, entry: u32) -> bool {
        let mut seen = BTreeSet::new();
        let mut work = vec![(entry, 0)];
        while let Some((mut address, mut it)) = work.pop() {
            while seen.insert(address) {
                let Ok(instruction) = decode(image, address, it) else {
                    break;
                };
                it = next_it(&instruction, it);
                let mut straight = true;
                match instruction.flow() {
                    Flow::Next | Flow::CallRegister { .. } => {}
                    Flow::Branch { target, .. } => work.push((target, 0)),
                    Flow::Jump { target } => {
                        if leaves(image, entry, target) {
                            if self.ask(image, target) {
                                return true;
                            }
                        } else {
                            work.push((target, 0));
                        }
                        straight = conditional(&instruction);
                    }
                    Flow::Call { target } => {
                        straight = conditional(&instruction) || self.ask(image, target);
                    }
                    Flow::Indirect => return true,
                    Flow::Stop => straight = conditional(&instruction),
                }
                address = instruction.next();
                if !straight || !image.is_code(address) {
                    break;
                }
            }
        }
        false
    }
}

/// `ITSTATE` after an instruction, which may begin an `IT` block itself.
fn next_it(instruction: &Instruction, it: u8) -> u8 {
    match instruction.insn {
        Insn::It { cond, mask } => (cond.0 << 4) | mask,
        _ => advance_it(it),
    }
}

/// Whether a function belongs to the panic handling and never returns.
#[must_use]
pub fn is_panic(name: &str) -> bool {
    const NEVER_RETURN: [&str; 9] = [
        "core::panicking::",
        "core::option::unwrap_failed",
        "core::option::expect_failed",
        "core::result::unwrap_failed",
        "core::slice::index::slice_",
        "core::str::slice_error_fail",
        "core::cell::panic_already",
        "__rustc::rust_",
        "defmt::export::panic",
    ];
    // As written in the sources of the compiler's libraries: a function of another crate may have such a name behind its
    // path, and return.
    let mismatch = name.starts_with("core::slice::") && name.contains("len_mismatch_fail");
    let plain = ["rust_begin_unwind", "rust_panic"];
    mismatch
        || plain.iter().any(|whole| is_whole(name, whole))
        || NEVER_RETURN.iter().any(|path| name.starts_with(path))
}

/// Whether a function resets the node: behind a fault, with its motor stopped, or to write a mission, when it has left
/// the bus. What follows on the path is no job any more: no deadline holds in a node that starts again.
#[must_use]
pub fn is_end(name: &str) -> bool {
    const ENDS: [&str; 2] = [
        "firmware::fault::stop",
        "firmware::mission::replace::replace",
    ];
    ENDS.iter().any(|end| is_whole(name, end))
}

/// Whether this is the whole name of a function, but for the hash that the compiler adds.
fn is_whole(name: &str, whole: &str) -> bool {
    let rest = name.strip_prefix(whole);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with("::h"))
}

/// A basic block: instructions without a branch between them.
#[derive(Debug, Clone)]
pub struct Block {
    /// Its instructions; never empty.
    pub instructions: Vec<Instruction>,
    /// Blocks of the same function that may follow.
    pub successors: Vec<usize>,
}

impl Block {
    /// Address of the first instruction.
    #[must_use]
    pub fn start(&self) -> u32 {
        self.instructions[0].address
    }

    /// The last instruction.
    #[must_use]
    pub fn last(&self) -> &Instruction {
        self.split_last().0
    }

    /// The last instruction, and those before it.
    #[must_use]
    pub fn split_last(&self) -> (&Instruction, &[Instruction]) {
        let (body, last) = self.instructions.split_at(self.instructions.len() - 1);
        (&last[0], body)
    }
}

/// A loop of the control flow.
#[derive(Debug, Clone)]
pub struct Loop {
    /// Its header: every turn passes this block. Control may also enter the loop elsewhere.
    pub header: usize,
    /// Its blocks, those of inner loops included.
    pub blocks: BTreeSet<usize>,
    /// The loop directly around it.
    pub parent: Option<usize>,
}

/// The control-flow graph of one function.
#[derive(Debug, Clone)]
pub struct Graph {
    /// Address of the function.
    pub entry: u32,
    /// Blocks in reverse postorder; the first is the entry.
    pub blocks: Vec<Block>,
    /// Loops, outer ones before inner ones.
    pub loops: Vec<Loop>,
    /// Innermost loop of each block.
    pub innermost: Vec<Option<usize>>,
    /// Registers that it saves when it begins and restores before it ends, and that belong to the caller
    /// (AAPCS32 6.1.1).
    pub saved: RegisterSet,
    index: HashMap<u32, usize>,
}

impl Graph {
    /// Rebuilds the function at `entry`.
    ///
    /// # Errors
    /// When there is no code at `entry`.
    pub fn build(
        image: &Image,
        entry: u32,
        targets: &Targets,
        returning: &mut Returning,
    ) -> Result<Self, NotCode> {
        let mut instructions: BTreeMap<u32, Instruction> = BTreeMap::new();
        let mut leaders = BTreeSet::from([entry]);
        let mut work = vec![entry];
        while let Some(start) = work.pop() {
            let mut address = start;
            let mut it = 0;
            loop {
                if instructions.contains_key(&address) {
                    break;
                }
                let instruction = match decode(image, address, it) {
                    Ok(instruction) if image.is_code(address) => instruction,
                    _ if address == entry => return Err(NotCode(entry)),
                    // Not decoded: a path that reaches it is reported by the walk.
                    _ => break,
                };
                instructions.insert(address, instruction);
                it = next_it(&instruction, it);
                let ends = ends_block(&instruction);
                for target in local_targets(image, entry, &instruction, targets) {
                    if leaders.insert(target) || !instructions.contains_key(&target) {
                        work.push(target);
                    }
                }
                address = instruction.next();
                if ends {
                    if falls_through(image, &instruction, returning)
                        && continues(image, entry, address)
                    {
                        leaders.insert(address);
                        work.push(address);
                    }
                    break;
                }
            }
        }
        Ok(Self::assemble(
            image,
            entry,
            &instructions,
            &leaders,
            targets,
            returning,
        ))
    }

    /// Groups the instructions into blocks, which begin at the `leaders`.
    fn assemble(
        image: &Image,
        entry: u32,
        instructions: &BTreeMap<u32, Instruction>,
        leaders: &BTreeSet<u32>,
        targets: &Targets,
        returning: &mut Returning,
    ) -> Self {
        let mut raw: BTreeMap<u32, (Vec<Instruction>, Vec<u32>)> = BTreeMap::new();
        for &leader in leaders {
            let mut run = Vec::new();
            let mut address = leader;
            let mut successors = Vec::new();
            while let Some(instruction) = instructions.get(&address) {
                run.push(*instruction);
                address = instruction.next();
                if ends_block(instruction) {
                    successors.extend(local_targets(image, entry, instruction, targets));
                    if falls_through(image, instruction, returning)
                        && continues(image, entry, address)
                        && instructions.contains_key(&address)
                    {
                        successors.push(address);
                    }
                    break;
                }
                if leaders.contains(&address) {
                    successors.push(address);
                    break;
                }
            }
            if !run.is_empty() {
                successors.sort_unstable();
                successors.dedup();
                raw.insert(leader, (run, successors));
            }
        }
        let order = reverse_postorder(entry, &raw);
        let index: HashMap<u32, usize> = order
            .iter()
            .enumerate()
            .map(|(position, address)| (*address, position))
            .collect();
        let blocks = order
            .iter()
            .map(|address| {
                let (run, successors) = &raw[address];
                Block {
                    instructions: run.clone(),
                    successors: successors
                        .iter()
                        .filter_map(|target| index.get(target).copied())
                        .collect(),
                }
            })
            .collect();
        let mut graph = Self {
            entry,
            blocks,
            loops: Vec::new(),
            innermost: Vec::new(),
            saved: RegisterSet::NONE,
            index,
        };
        graph.find_loops();
        graph.saved = graph.find_saved(image);
        graph
    }

    /// The block that begins at `address`.
    #[must_use]
    pub fn block_at(&self, address: u32) -> Option<usize> {
        self.index.get(&address).copied()
    }

    /// The registers of [`Self::saved`]: those that the first block pushes and each block that leaves the function
    /// pops.
    fn find_saved(&self, image: &Image) -> RegisterSet {
        let moved = |block: &Block, wanted: bool| {
            let lists = block.instructions.iter().filter_map(|one| match one.insn {
                Insn::LoadStoreMultiple { load, rn, list, .. } => {
                    let is_wanted = load == wanted && Register::new(rn) == Register::SP;
                    is_wanted.then_some(RegisterSet::from_bits(list))
                }
                _ => None,
            });
            lists.fold(RegisterSet::NONE, |all, list| all | list)
        };
        let Some(first) = self.blocks.first() else {
            return RegisterSet::NONE;
        };
        let leaves_here = |block: &&Block| {
            let last = block.last();
            match last.flow() {
                Flow::Indirect => block.successors.is_empty() || conditional(last),
                Flow::Jump { target } | Flow::Branch { target, .. } => {
                    leaves(image, self.entry, target)
                }
                _ => false,
            }
        };
        let ends = self.blocks.iter().filter(leaves_here);
        ends.fold(
            moved(first, false) & RegisterSet::PRESERVED,
            |saved, end| saved & moved(end, true),
        )
    }

    fn find_loops(&mut self) {
        let count = self.blocks.len();
        let mut predecessors = vec![Vec::new(); count];
        for (from, block) in self.blocks.iter().enumerate() {
            for &to in &block.successors {
                predecessors[to].push(from);
            }
        }
        // An edge against the reverse postorder closes a loop. The blocks of the loop are those
        // that are on a cycle with the header and come after it in the order. If the header
        // dominates them, this is the natural loop. If control also enters in the middle, it is
        // still a loop in which every turn passes the header.
        let headers: BTreeSet<usize> = self
            .blocks
            .iter()
            .enumerate()
            .flat_map(|(from, block)| block.successors.iter().filter(move |to| **to <= from))
            .copied()
            .collect();
        let reach = |header: usize, next: &dyn Fn(usize) -> Vec<usize>| {
            let mut seen = BTreeSet::new();
            let mut work = vec![header];
            while let Some(block) = work.pop() {
                for other in next(block) {
                    if other >= header && seen.insert(other) {
                        work.push(other);
                    }
                }
            }
            seen
        };
        let mut bodies: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        for header in headers {
            let after = reach(header, &|block| self.blocks[block].successors.clone());
            let before = reach(header, &|block| predecessors[block].clone());
            bodies.insert(header, after.intersection(&before).copied().collect());
        }
        let mut loops: Vec<Loop> = bodies
            .into_iter()
            .map(|(header, blocks)| Loop {
                header,
                blocks,
                parent: None,
            })
            .collect();
        loops.sort_by_key(|l| (std::cmp::Reverse(l.blocks.len()), l.header));
        for inner in 0..loops.len() {
            loops[inner].parent = (0..inner)
                .rev()
                .find(|&outer| loops[outer].blocks.contains(&loops[inner].header));
        }
        self.innermost = vec![None; count];
        for (number, l) in loops.iter().enumerate() {
            for &block in &l.blocks {
                self.innermost[block] = Some(number);
            }
        }
        self.loops = loops;
    }

    /// The loop directly inside `region` that holds `block`, if any.
    #[must_use]
    pub fn child_loop(&self, region: Option<usize>, block: usize) -> Option<usize> {
        let mut current = self.innermost[block];
        let mut child = None;
        while current != region {
            child = current;
            current = self.loops[current?].parent;
        }
        child
    }
}

/// Addresses of the blocks in reverse postorder.
fn reverse_postorder(entry: u32, raw: &BTreeMap<u32, (Vec<Instruction>, Vec<u32>)>) -> Vec<u32> {
    let mut order = Vec::new();
    let mut seen = BTreeSet::from([entry]);
    let mut stack = vec![(entry, 0)];
    while let Some((address, next)) = stack.pop() {
        let successors = raw.get(&address).map_or(&[][..], |(_, s)| &s[..]);
        match successors.get(next) {
            Some(&target) => {
                stack.push((address, next + 1));
                if raw.contains_key(&target) && seen.insert(target) {
                    stack.push((target, 0));
                }
            }
            None => order.push(address),
        }
    }
    order.reverse();
    order
}

/// Whether control may go elsewhere than to the next instruction.
fn ends_block(instruction: &Instruction) -> bool {
    instruction.flow() != Flow::Next
}

/// Whether control may go on to the next instruction.
fn falls_through(image: &Image, instruction: &Instruction, returning: &mut Returning) -> bool {
    match instruction.flow() {
        Flow::Next | Flow::Branch { .. } | Flow::CallRegister { .. } => true,
        Flow::Call { target } => conditional(instruction) || returning.ask(image, target),
        Flow::Jump { .. } | Flow::Indirect | Flow::Stop => conditional(instruction),
    }
}

/// Whether the instruction is conditional by its `IT` block.
#[must_use]
pub fn conditional(instruction: &Instruction) -> bool {
    instruction
        .condition
        .is_some_and(|condition| condition.0 < 14)
}

/// Whether the function continues at `address`. After a call that never returns, the next
/// function or data may follow.
fn continues(image: &Image, entry: u32, address: u32) -> bool {
    image.is_code(address) && (address == entry || image.function(address).is_none())
}

/// Whether `target` is another function than the one at `entry`.
#[must_use]
pub fn leaves(image: &Image, entry: u32, target: u32) -> bool {
    target != entry && image.function(target).is_some()
}

/// The targets of a table branch, by the table that follows it.
fn table(image: &Image, instruction: &Instruction) -> Vec<u32> {
    let Insn::TableBranch { rn: 15, half, .. } = instruction.insn else {
        return Vec::new();
    };
    let size = if half { 2 } else { 1 };
    let Some((start, end)) = image.table_end(instruction.next()) else {
        return Vec::new();
    };
    (start..end)
        .step_by(size as usize)
        .filter_map(|at| image.constant(at, size))
        .map(|entry| start + 2 * entry)
        .collect()
}

/// The targets of an instruction within its function.
fn local_targets(
    image: &Image,
    entry: u32,
    instruction: &Instruction,
    targets: &Targets,
) -> Vec<u32> {
    let local = |target: &u32| !leaves(image, entry, *target) && image.is_code(*target);
    match instruction.flow() {
        Flow::Branch { target, .. } | Flow::Jump { target } => {
            Some(target).filter(local).into_iter().collect()
        }
        Flow::Indirect => {
            let found = targets.get(&instruction.address).into_iter().flatten();
            let mut all: Vec<u32> = found.copied().chain(table(image, instruction)).collect();
            all.retain(local);
            all
        }
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::{is_end, is_panic};

    #[test]
    fn a_path_ends_where_a_node_starts_anew() {
        for name in [
            "firmware::fault::stop",
            "firmware::fault::stop::h0123456789abcdef",
            "firmware::mission::replace::replace",
        ] {
            assert!(is_end(name), "{name}");
        }
        for name in [
            "firmware::fault::stop_motor",
            "other::firmware::fault::stop",
            "firmware::mission::work::step",
            "firmware::mission::store::write",
        ] {
            assert!(!is_end(name), "{name}");
        }
    }

    #[test]
    fn a_panic_is_one_of_the_compilers() {
        for name in [
            "core::panicking::panic_fmt",
            "core::slice::copy_from_slice_impl::len_mismatch_fail",
            "core::slice::<impl [T]>::copy_from_slice::len_mismatch_fail::h0123456789abcdef",
            "__rustc::rust_begin_unwind",
            "rust_begin_unwind",
            "defmt::export::panic",
        ] {
            assert!(is_panic(name), "{name}");
        }
        for name in ["hardcore::panicking::note", "app::rust_panic_button"] {
            assert!(!is_panic(name), "{name}");
        }
    }
}
