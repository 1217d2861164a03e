//! Stack depth over the static call graph, panic paths included.

use std::collections::{BTreeMap, BTreeSet};

use rsemu::cpu::arm::v7m::fpisa::FpInsn;
use rsemu::cpu::arm::v7m::isa::{DpOp, Insn, Operand};

use crate::graph::{Graph, Returning, Targets};
use crate::image::Image;
use crate::instruction::{Flow, Instruction};
use crate::software;

/// Bytes of an exception frame without and with floating-point registers,
/// each with the word that may align it.
pub const FRAME: u32 = 32 + 4;
/// See [`FRAME`].
pub const FRAME_FPU: u32 = 104 + 4;

/// Depth below a function's entry, and what could not be followed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Depth {
    /// Bytes, of everything that could be followed.
    pub bytes: u32,
    /// Calls through pointers, recursion, and stack pointers set to something
    /// unknown: each makes `bytes` a lower figure than the truth may be.
    pub unknown: BTreeSet<String>,
}

/// Finds depths in one image.
#[derive(Debug)]
pub struct Stacks<'a> {
    image: &'a Image,
    known: BTreeMap<u32, Depth>,
    returning: Returning,
}

impl<'a> Stacks<'a> {
    /// Of this image.
    #[must_use]
    pub fn new(image: &'a Image) -> Self {
        Self {
            image,
            known: BTreeMap::new(),
            returning: Returning::default(),
        }
    }

    /// Depth of the function at `entry` with everything it may call, panics
    /// included.
    pub fn depth(&mut self, entry: u32) -> Depth {
        self.visit(entry, &mut Vec::new())
    }

    fn visit(&mut self, entry: u32, path: &mut Vec<u32>) -> Depth {
        if let Some(known) = self.known.get(&entry) {
            return known.clone();
        }
        let mut depth = Depth::default();
        if path.contains(&entry) {
            depth
                .unknown
                .insert(format!("recursion through {}", self.image.name(entry)));
            return depth;
        }
        let Ok(graph) = Graph::build(self.image, entry, &Targets::new(), &mut self.returning)
        else {
            depth
                .unknown
                .insert(format!("no code at {}", self.image.name(entry)));
            return depth;
        };
        path.push(entry);
        // The deepest stack pointer on entry of each block.
        let mut at: BTreeMap<usize, u32> = BTreeMap::from([(0, 0)]);
        let mut deepened: BTreeMap<usize, u32> = BTreeMap::new();
        let mut work = vec![0];
        while let Some(block) = work.pop() {
            let mut below = at[&block];
            for instruction in &graph.blocks[block].instructions {
                match change(instruction) {
                    Change::By(bytes) => below = below.saturating_add_signed(bytes),
                    Change::Frame => {}
                    Change::Unknown => {
                        depth.unknown.insert(format!(
                            "stack pointer at {}",
                            self.image.describe(instruction.address)
                        ));
                    }
                }
                depth.bytes = depth.bytes.max(below);
                let callees: Vec<u32> = match instruction.flow() {
                    Flow::Call { target } => vec![target],
                    Flow::Jump { target } | Flow::Branch { target, .. }
                        if crate::graph::leaves(self.image, entry, target) =>
                    {
                        vec![target]
                    }
                    _ if instruction.calls_through_pointer() => {
                        let targets = software::targets(self.image, entry);
                        if targets.is_none() {
                            depth.unknown.insert(format!(
                                "call through a pointer at {}",
                                self.image.describe(instruction.address)
                            ));
                        }
                        targets.into_iter().flatten().collect()
                    }
                    _ => Vec::new(),
                };
                for callee in callees {
                    let of_callee = self.visit(callee, path);
                    depth.bytes = depth.bytes.max(below + of_callee.bytes);
                    depth.unknown.extend(of_callee.unknown);
                }
            }
            for &next in &graph.blocks[block].successors {
                let known = at.get(&next).copied();
                // Loops do not deepen the stack in compiled code; one that
                // seems to is listed instead of followed.
                if known.is_none_or(|known| known < below) {
                    let times = deepened.entry(next).or_default();
                    *times += 1;
                    if *times > MAX_DEEPENED {
                        depth.unknown.insert(format!(
                            "a loop in {} that deepens the stack",
                            self.image.name(entry)
                        ));
                        continue;
                    }
                    at.insert(next, below);
                    work.push(next);
                }
            }
        }
        path.pop();
        self.known.insert(entry, depth.clone());
        depth
    }
}

/// How often a block's depth may grow before it counts as unknown.
const MAX_DEEPENED: u32 = 8;

enum Change {
    By(i32),
    /// Restored from the frame pointer: never deeper than before.
    Frame,
    Unknown,
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
        // Aligning down by at most the mask.
        Insn::Bitfield { rd: 13, width, .. } => Change::By((1i32 << width) - 1),
        Insn::DataProc {
            op: DpOp::Mov,
            rd: 13,
            operand: Operand::Reg { .. },
            ..
        } => Change::Frame,
        _ if instruction.written() & (1 << 13) != 0 => Change::Unknown,
        _ => Change::By(0),
    }
}
