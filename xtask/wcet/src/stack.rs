//! Stack depth by the static call graph, with panic paths.

use std::collections::{BTreeMap, BTreeSet};

use rsemu::cpu::arm::v7m::fpisa::FpInsn;
use rsemu::cpu::arm::v7m::isa::{DpOp, Insn, Operand};

use crate::graph::{Graph, Returning, Targets, leaves};
use crate::image::Image;
use crate::instruction::{Flow, Instruction, decode};
use crate::register::Register;
use crate::software;

/// Bytes of an exception frame with floating-point registers, with the word that may align it.
pub const FRAME_FPU: u32 = 104 + 4;

/// Depth below the stack pointer on a function's entry.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Depth {
    /// Bytes, for all code that could be followed.
    pub bytes: u32,
    /// Code that could not be followed: calls through pointers, recursion, and stack pointers that
    /// are set to an unknown address. With any of these the depth may exceed `bytes`.
    pub unknown: BTreeSet<String>,
}

impl Depth {
    /// No depth, for this reason.
    fn unknown(what: String) -> Self {
        Self {
            bytes: 0,
            unknown: BTreeSet::from([what]),
        }
    }
}

/// Finds the depths of the functions of one image.
#[derive(Debug)]
pub struct Stacks<'a> {
    image: &'a Image,
    known: BTreeMap<u32, Depth>,
    returning: Returning,
}

impl<'a> Stacks<'a> {
    /// For this image.
    #[must_use]
    pub fn new(image: &'a Image) -> Self {
        Self {
            image,
            known: BTreeMap::new(),
            returning: Returning::default(),
        }
    }

    /// Depth of the function at `entry` with all functions that it may call, panics included.
    pub fn depth(&mut self, entry: u32) -> Depth {
        self.visit(entry, &mut Vec::new())
    }

    /// Whether the handler at `entry` sets the main stack pointer before anything else that may
    /// use the stack, and so discards what is on the stack.
    #[must_use]
    pub fn begins_anew(&self, entry: u32) -> bool {
        let mut at = entry;
        while let Ok(instruction) = decode(self.image, at, 0) {
            if sets_main_stack(&instruction) {
                return true;
            }
            let moves = matches!(
                instruction.insn,
                Insn::MovImm16 { .. } | Insn::LoadLiteral { .. } | Insn::Cps { .. }
            );
            if !moves || instruction.flow() != Flow::Next {
                return false;
            }
            at = instruction.next();
        }
        false
    }

    /// Depth of the function at `entry`. `path` holds the functions that are being visited.
    fn visit(&mut self, entry: u32, path: &mut Vec<u32>) -> Depth {
        if let Some(known) = self.known.get(&entry) {
            return known.clone();
        }
        if path.contains(&entry) {
            return Depth::unknown(format!("recursion through {}", self.image.name(entry)));
        }
        let graph = Graph::build(self.image, entry, &Targets::new(), &mut self.returning);
        let Ok(graph) = graph else {
            return Depth::unknown(format!("no code at {}", self.image.name(entry)));
        };
        path.push(entry);
        let mut depth = Depth::default();
        // The greatest depth on entry of each block.
        let mut at: BTreeMap<usize, u32> = BTreeMap::from([(0, 0)]);
        let mut deepened: BTreeMap<usize, u32> = BTreeMap::new();
        let mut work = vec![0];
        while let Some(block) = work.pop() {
            let below = self.block(&graph, block, at[&block], &mut depth, path);
            for &next in &graph.blocks[block].successors {
                let known = at.get(&next).copied();
                if known.is_some_and(|known| known >= below) {
                    continue;
                }
                // In compiled code no loop deepens the stack from turn to turn. One that seems to
                // is reported and not followed any further.
                let times = deepened.entry(next).or_default();
                *times += 1;
                if *times > MAX_DEEPENED {
                    let function = self.image.name(entry);
                    let what = format!("a loop in {function} that deepens the stack");
                    depth.unknown.insert(what);
                    continue;
                }
                at.insert(next, below);
                work.push(next);
            }
        }
        path.pop();
        self.known.insert(entry, depth.clone());
        depth
    }

    /// Adds a block that is entered at the depth `below`, and the functions that it calls, to
    /// `depth`. Returns the depth at the end of the block.
    fn block(
        &mut self,
        graph: &Graph,
        number: usize,
        mut below: u32,
        depth: &mut Depth,
        path: &mut Vec<u32>,
    ) -> u32 {
        for instruction in &graph.blocks[number].instructions {
            match change(instruction) {
                Change::By(bytes) => below = below.saturating_add_signed(bytes),
                Change::Frame => {}
                Change::Anew if self.begins_anew(graph.entry) && path.len() == 1 => {}
                Change::Anew | Change::Unknown => {
                    let place = self.image.describe(instruction.address);
                    depth.unknown.insert(format!("stack pointer at {place}"));
                }
            }
            depth.bytes = depth.bytes.max(below);
            for callee in self.callees(graph.entry, instruction, depth) {
                let of_callee = self.visit(callee, path);
                depth.bytes = depth.bytes.max(below + of_callee.bytes);
                depth.unknown.extend(of_callee.unknown);
            }
        }
        below
    }

    /// The functions that an instruction of the function at `entry` may call or jump to.
    fn callees(&self, entry: u32, instruction: &Instruction, depth: &mut Depth) -> Vec<u32> {
        match instruction.flow() {
            Flow::Call { target } => vec![target],
            Flow::Jump { target } | Flow::Branch { target, .. }
                if leaves(self.image, entry, target) =>
            {
                vec![target]
            }
            _ if instruction.calls_through_pointer() => {
                let targets = software::targets(self.image, entry, instruction.address);
                if targets.is_none() {
                    let place = self.image.describe(instruction.address);
                    let what = format!("call through a pointer at {place}");
                    depth.unknown.insert(what);
                }
                targets.into_iter().flatten().collect()
            }
            _ => Vec::new(),
        }
    }
}

/// How often the depth of a block may grow before it counts as unknown.
const MAX_DEEPENED: u32 = 8;

/// How an instruction changes the stack pointer.
enum Change {
    /// By this number of bytes; positive if the stack becomes deeper.
    By(i32),
    /// Restored from the frame pointer, and so not deeper than before.
    Frame,
    /// Set to the begin of a stack. Only the handler of a fault does so, which never returns.
    Anew,
    /// Set to an unknown address.
    Unknown,
}

/// Number of the main stack pointer in `MSR` (DDI 0403 B5.1.1).
const MSP: u8 = 8;

/// Whether an instruction sets the main stack pointer by `MSR`.
pub(crate) fn sets_main_stack(instruction: &Instruction) -> bool {
    matches!(instruction.insn, Insn::Msr { sysm: MSP, .. })
}

fn change(instruction: &Instruction) -> Change {
    match instruction.insn {
        Insn::LoadStoreMultiple {
            load,
            rn: 13,
            list,
            wback: true,
            ..
        } => {
            let bytes = 4 * list.count_ones() as i32;
            Change::By(if load { -bytes } else { bytes })
        }
        Insn::DataProc {
            op: op @ (DpOp::Add | DpOp::Sub),
            rd: 13,
            rn: 13,
            operand: Operand::Imm { value, .. },
            ..
        } => Change::By(if op == DpOp::Sub {
            value as i32
        } else {
            -(value as i32)
        }),
        Insn::LoadStore {
            rn: 13,
            wback: true,
            add,
            offset: rsemu::cpu::arm::v7m::isa::MemOffset::Imm(value),
            ..
        } => Change::By(if add { -(value as i32) } else { value as i32 }),
        Insn::Fp(FpInsn::Multi {
            rn: 13,
            writeback: true,
            count,
            add,
            ..
        }) => {
            let bytes = 4 * i32::from(count);
            Change::By(if add { -bytes } else { bytes })
        }
        Insn::DataProc {
            op: DpOp::Sub | DpOp::Mov | DpOp::Add,
            rd: 13,
            rn,
            operand,
            ..
        } if rn == 7 || matches!(operand, Operand::Reg { rm: 7, .. } if rn != 13) => Change::Frame,
        // Aligned down, by at most the mask.
        Insn::Bitfield { rd: 13, width, .. } => Change::By((1i32 << width) - 1),
        Insn::DataProc {
            op: DpOp::Mov,
            rd: 13,
            operand: Operand::Reg { .. },
            ..
        } => Change::Frame,
        _ if sets_main_stack(instruction) => Change::Anew,
        _ if instruction.written().contains(Register::SP) => Change::Unknown,
        _ => Change::By(0),
    }
}
