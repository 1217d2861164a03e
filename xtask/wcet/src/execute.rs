//! What one instruction does to the abstract machine.

use std::rc::Rc;

use rsemu::cpu::arm::v7m::fpisa::{FpInsn, UnaryOp};
use rsemu::cpu::arm::v7m::isa::{
    BitfieldOp, DpOp, ExtendOp, Insn, MemOffset, MiscOp, Operand, Shift, ShiftType,
};

use super::flags::Flags;
use super::image::Image;
use super::instruction::Instruction;
use super::lasting::{EVERYWHERE, FAR, Memory, RAM, leads_to_memory, places, reach};
use super::range::Range;
use super::state::{Definition, Masked, STACK, State, Symbols};
use super::value::Value;

/// A memory access of an instruction, for its timing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Access {
    /// Every address the first byte may have.
    pub address: Range,
    /// A load rather than a store.
    pub load: bool,
    /// Bytes of one transfer: 1, 2 or 4.
    pub size: u32,
    /// How many transfers.
    pub count: u32,
}

/// What an instruction did besides changing the state.
#[derive(Debug, Clone, Default)]
pub struct Effects {
    /// Its memory access.
    pub access: Option<Access>,
    /// Masks that end with it.
    pub unmasked: Vec<Masked>,
    /// A write to the program counter: the words it may take.
    pub target: Option<Value>,
    /// `BASEPRI` was written with a word that is not known.
    pub unknown_mask: bool,
}

/// Executes instructions of one image.
#[derive(Debug)]
pub struct Executor<'a> {
    /// Where constants come from.
    pub image: &'a Image,
    /// Where unknown words get their names.
    pub symbols: Symbols,
    /// What is known of memory that is no stack.
    pub memory: Memory,
}

/// Where the parts have their peripherals.
const PERIPHERALS: Range = Range::between(0x4000_0000, 0x5fff_ffff);
/// The most RAM that a part has: behind its own bus, and in general.
const FITTED: [Range; 2] = [
    Range::between(0x1000_0000, 0x1000_ffff),
    Range::between(0x2000_0000, 0x2002_ffff),
];
/// Constants joined for a load with several possible addresses.
const MAX_LOADS: u64 = 4096;

impl Executor<'_> {
    /// What was found out about memory.
    #[must_use]
    pub fn into_memory(self) -> Memory {
        Memory {
            lost: self.memory.lost || self.symbols.mixed,
            ..self.memory
        }
    }

    /// Executes `instruction`, its condition taken as true.
    pub fn execute(&mut self, state: &mut State, instruction: &Instruction) -> Effects {
        let started = state.started;
        let effects = self.run(state, instruction);
        if !started && state.started {
            self.memory.enabled(&state.memory);
            state.memory = Rc::default();
        }
        if !started && effects.unknown_mask {
            self.memory.lost = true;
        }
        effects
    }

    fn run(&mut self, state: &mut State, instruction: &Instruction) -> Effects {
        let mut effects = Effects::default();
        let pc = instruction.address.wrapping_add(4);
        let read = |state: &State, register: u8| match register {
            15 => Value::constant(pc),
            _ => state.registers[usize::from(register)],
        };
        match instruction.insn {
            Insn::DataProc {
                op,
                s,
                rd,
                rn,
                operand,
            } => {
                let (second, carry_lost) = match operand {
                    Operand::Imm { value, carry } => (Value::constant(value), carry.is_some()),
                    Operand::Reg { rm, shift } => {
                        let value = read(state, rm);
                        let mut result = shifted(&value, shift);
                        self.scale(&value, shift, &mut result);
                        let result = self.named(result);
                        (result, !shift.is_none())
                    }
                };
                let first = read(state, rn);
                let result = match (op, self.symbols.definition(&second)) {
                    (DpOp::Sub, Some(Definition::Product(a, b))) => {
                        remainder(&self.symbols, &first, a, b)
                    }
                    _ => None,
                }
                .unwrap_or_else(|| data_processing(op, &first, &second, state.flags.carry()));
                let result = match op {
                    DpOp::Add | DpOp::And | DpOp::Bic => {
                        self.symbols.moved(result, &first, &second)
                    }
                    DpOp::Sub => self.symbols.moved_down(result, &first, &second),
                    DpOp::Rsb => self.symbols.moved_down(result, &second, &first),
                    _ => result,
                };
                let result = match operand {
                    // A word and itself shifted: a product that was reduced.
                    Operand::Reg { rm, shift }
                        if op == DpOp::Add
                            && rm == rn
                            && shift.ty == ShiftType::Lsl
                            && !shift.is_none()
                            && self.symbols.definition(&first).is_some()
                            && result.as_constant().is_none() =>
                    {
                        let factor = Value::constant(1 + (1 << shift.amount));
                        let product = self.symbols.define(Definition::Product(first, factor));
                        Value {
                            base: Some((product, Range::constant(0))),
                            ..result
                        }
                    }
                    _ => result,
                };
                if s {
                    state.flags = match op {
                        DpOp::Cmp | DpOp::Sub => Flags::difference(first, second),
                        DpOp::Rsb => Flags::difference(second, first),
                        DpOp::Cmn | DpOp::Add => Flags::sum(first, second),
                        DpOp::Adc | DpOp::Sbc => {
                            let mut flags = Flags::ANY.result(result, true);
                            if let (Some(a), Some(b), Some(carry)) = (
                                first.as_constant(),
                                second.as_constant(),
                                state.flags.carry(),
                            ) {
                                flags.possible = 1 << with_carry(op, a, b, carry);
                            }
                            flags
                        }
                        _ => state.flags.result(result, carry_lost),
                    };
                }
                if !op.is_test() {
                    if rd == 15 {
                        effects.target = Some(result);
                    } else {
                        self.set(state, rd, result);
                        // A flag-setting operation and its result are one
                        // value: what a branch learns of one holds for both.
                        if s && !matches!(
                            op,
                            DpOp::Sub | DpOp::Rsb | DpOp::Add | DpOp::Adc | DpOp::Sbc
                        ) {
                            let named = state.registers[usize::from(rd)];
                            state.flags.source = Some(super::flags::Source::Result(named));
                        }
                    }
                }
            }
            Insn::ShiftReg { ty, s, rd, rn, rm } => {
                let value = read(state, rn);
                let result = match read(state, rm).as_constant().map(|amount| amount & 0xff) {
                    Some(0) => value,
                    Some(amount @ 1..=31) => shifted(
                        &value,
                        Shift {
                            ty,
                            amount: amount as u8,
                        },
                    ),
                    Some(_) if matches!(ty, ShiftType::Lsl | ShiftType::Lsr) => Value::constant(0),
                    _ if ty == ShiftType::Lsr => {
                        Value::with_range(Range::between(0, value.range.unsigned().1), &[&value])
                    }
                    _ => Value::with_range(Range::ALL, &[&value]),
                };
                if s {
                    state.flags = state.flags.result(result, true);
                }
                self.set(state, rd, result);
            }
            Insn::Adr { rd, imm, add } => {
                let base = pc & !3;
                let address = if add {
                    base.wrapping_add(imm)
                } else {
                    base.wrapping_sub(imm)
                };
                self.set(state, rd, Value::constant(address));
            }
            Insn::MovImm16 { top, rd, imm } => {
                let value = if top {
                    let low = read(state, rd).range.and(Range::constant(0xffff));
                    Value::within(low.add(Range::constant(u32::from(imm) << 16)))
                } else {
                    Value::constant(u32::from(imm))
                };
                self.set(state, rd, value);
            }
            Insn::BranchLink { .. } | Insn::Blx { .. } => {
                if let Insn::Blx { rm } = instruction.insn {
                    effects.target = Some(read(state, rm));
                }
                state.registers[14] = Value::constant(instruction.next() | 1);
            }
            Insn::Bx { rm } => effects.target = Some(read(state, rm)),
            Insn::TableBranch { rn, rm, half } => {
                let base = read(state, rn);
                let index = read(state, rm);
                let size = if half { 2 } else { 1 };
                // The table ends where the linker's map of the code says so;
                // that no index lies beyond is the compiler's own promise (it
                // knows the variants of an enumeration).
                let index = match base.as_constant().and_then(|at| self.image.table_end(at)) {
                    Some((start, end)) => {
                        let last = (end - start) / size - 1;
                        let range = index.range.meet(Range::between(0, last));
                        Value {
                            range: range.unwrap_or(Range::between(0, last)),
                            ..index
                        }
                    }
                    None => index,
                };
                let at = base.add(&shifted(
                    &index,
                    Shift {
                        ty: ShiftType::Lsl,
                        amount: u8::from(half),
                    },
                ));
                effects.access = Some(Access {
                    address: at.range,
                    load: true,
                    size,
                    count: 1,
                });
                // The table may be padded by an entry that leads into itself.
                let targets: Option<Vec<u32>> = (at.range.count() <= MAX_LOADS).then(|| {
                    let entries = at.range.iter().map(|at| self.image.constant(at, size));
                    let entries: Vec<u32> = entries.flatten().collect();
                    let targets = entries.iter().map(|entry| pc.wrapping_add(2 * entry));
                    targets.filter(|at| self.image.is_code(*at)).collect()
                });
                let targets = targets.and_then(|targets| self.symbols.one_of(targets));
                effects.target = Some(targets.unwrap_or(Value::ANY));
            }
            Insn::LoadStore {
                load,
                size,
                signed,
                rt,
                rn,
                offset,
                index,
                add,
                wback,
                ..
            } => {
                let base = read(state, rn);
                let delta = match offset {
                    MemOffset::Imm(value) => Value::constant(value),
                    MemOffset::Reg { rm, lsl } => {
                        let shift = Shift {
                            ty: ShiftType::Lsl,
                            amount: lsl,
                        };
                        self.named(shifted(&read(state, rm), shift))
                    }
                };
                let moved = if add {
                    base.add(&delta)
                } else {
                    base.subtract(&delta)
                };
                let moved = if add {
                    self.symbols.moved(moved, &base, &delta)
                } else {
                    self.symbols.moved_down(moved, &base, &delta)
                };
                let address = if index { moved } else { base };
                effects.access = Some(Access {
                    address: address.range,
                    load,
                    size: size.bytes(),
                    count: 1,
                });
                if load {
                    let value = self.load(state, &address, size.bytes(), signed);
                    if wback {
                        self.set(state, rn, moved);
                    }
                    if rt == 15 {
                        effects.target = Some(value);
                    } else {
                        self.set(state, rt, value);
                    }
                } else {
                    let value = read(state, rt);
                    self.store(state, &address, size.bytes(), &value);
                    if wback {
                        self.set(state, rn, moved);
                    }
                }
            }
            Insn::LoadLiteral {
                size,
                signed,
                rt,
                imm,
                add,
            } => {
                let base = pc & !3;
                let address = Value::constant(if add {
                    base.wrapping_add(imm)
                } else {
                    base.wrapping_sub(imm)
                });
                effects.access = Some(Access {
                    address: address.range,
                    load: true,
                    size: size.bytes(),
                    count: 1,
                });
                let value = self.load(state, &address, size.bytes(), signed);
                if rt == 15 {
                    effects.target = Some(value);
                } else {
                    self.set(state, rt, value);
                }
            }
            Insn::LoadStoreDual {
                load,
                rt,
                rt2,
                rn,
                imm,
                index,
                add,
                wback,
            } => {
                let base = if rn == 15 {
                    Value::constant(pc & !3)
                } else {
                    read(state, rn)
                };
                let moved = if add {
                    base.add(&Value::constant(imm))
                } else {
                    base.subtract(&Value::constant(imm))
                };
                let address = if index { moved } else { base };
                let second = address.add(&Value::constant(4));
                effects.access = Some(Access {
                    address: address.range,
                    load,
                    size: 4,
                    count: 2,
                });
                if load {
                    let a = self.load(state, &address, 4, false);
                    let b = self.load(state, &second, 4, false);
                    self.set(state, rt, a);
                    self.set(state, rt2, b);
                } else {
                    let (a, b) = (read(state, rt), read(state, rt2));
                    self.store(state, &address, 4, &a);
                    self.store(state, &second, 4, &b);
                }
                if wback && rn != 15 {
                    self.set(state, rn, moved);
                }
            }
            Insn::LoadStoreExclusive {
                load,
                size,
                rd,
                rt,
                rn,
                imm,
            } => {
                let address = read(state, rn).add(&Value::constant(imm));
                effects.access = Some(Access {
                    address: address.range,
                    load,
                    size: size.bytes(),
                    count: 1,
                });
                if load {
                    let value = self.load(state, &address, size.bytes(), false);
                    self.set(state, rt, value);
                } else {
                    // It may or may not have stored.
                    self.store(state, &address, size.bytes(), &Value::ANY);
                    self.set(state, rd, Value::within(Range::between(0, 1)));
                }
            }
            Insn::LoadStoreMultiple {
                load,
                rn,
                list,
                wback,
                before,
            } => {
                let base = read(state, rn);
                let count = list.count_ones();
                let bytes = Value::constant(4 * count);
                let (start, end) = if before {
                    let start = base.subtract(&bytes);
                    (start, start)
                } else {
                    (base, base.add(&bytes))
                };
                effects.access = Some(Access {
                    address: start.range,
                    load,
                    size: 4,
                    count,
                });
                let registers = (0..16u8).filter(|register| list & (1 << register) != 0);
                if load {
                    let mut values = Vec::with_capacity(16);
                    for (position, register) in registers.enumerate() {
                        let at = start.add(&Value::constant(4 * position as u32));
                        values.push((register, self.load(state, &at, 4, false)));
                    }
                    if wback {
                        self.set(state, rn, end);
                    }
                    for (register, value) in values {
                        if register == 15 {
                            effects.target = Some(value);
                        } else {
                            self.set(state, register, value);
                        }
                    }
                } else {
                    for (position, register) in registers.enumerate() {
                        let at = start.add(&Value::constant(4 * position as u32));
                        let value = read(state, register);
                        self.store(state, &at, 4, &value);
                    }
                    if wback {
                        self.set(state, rn, end);
                    }
                }
            }
            Insn::Mul {
                rd,
                rn,
                rm,
                ra,
                sub,
                s,
            } => {
                let (a, b) = (read(state, rn), read(state, rm));
                let product = Value::with_range(a.range.multiply(b.range), &[&a, &b]);
                let result = match ra {
                    None if product.as_constant().is_none() => Value {
                        base: Some((
                            self.symbols.define(Definition::Product(a, b)),
                            Range::constant(0),
                        )),
                        ..product
                    },
                    None => product,
                    Some(ra) if sub => {
                        let dividend = read(state, ra);
                        let remainder = remainder(&self.symbols, &dividend, &a, &b);
                        remainder.unwrap_or_else(|| dividend.subtract(&product))
                    }
                    Some(ra) => read(state, ra).add(&product),
                };
                if s {
                    state.flags = state.flags.result(result, false);
                }
                self.set(state, rd, result);
            }
            Insn::MulLong {
                signed,
                accumulate,
                rdlo,
                rdhi,
                rn,
                rm,
                umaal,
            } => {
                let (a, b) = (read(state, rn), read(state, rm));
                let mut low = Value::ANY;
                let mut high = Value::ANY;
                if !accumulate && !umaal {
                    if let (Some(x), Some(y)) = (a.as_constant(), b.as_constant()) {
                        let product = if signed {
                            (i64::from(x as i32) * i64::from(y as i32)) as u64
                        } else {
                            u64::from(x) * u64::from(y)
                        };
                        low = Value::constant(product as u32);
                        high = Value::constant((product >> 32) as u32);
                    } else if !signed {
                        let top = u64::from(a.range.unsigned().1) * u64::from(b.range.unsigned().1);
                        high = Value::within(Range::between(0, (top >> 32) as u32));
                        if let Ok(top) = u32::try_from(top) {
                            low = Value::within(Range::between(0, top));
                        }
                        let scaled = match (a.as_constant(), b.as_constant()) {
                            (None, Some(factor)) => Some((self.named(a), factor)),
                            (Some(factor), None) => Some((self.named(b), factor)),
                            _ => None,
                        };
                        if let Some((of, factor)) = scaled {
                            let symbol = self.symbols.define(Definition::Scaled {
                                of,
                                factor,
                                shift: 32,
                            });
                            high.base = Some((symbol, Range::constant(0)));
                        }
                    }
                }
                self.set(state, rdlo, low);
                self.set(state, rdhi, high);
            }
            Insn::Div { signed, rd, rn, rm } => {
                let (a, b) = (read(state, rn), read(state, rm));
                let range = match (a.as_constant(), b.as_constant()) {
                    (Some(x), Some(y)) if signed => Range::constant(if y == 0 {
                        0
                    } else {
                        (x as i32).wrapping_div(y as i32) as u32
                    }),
                    _ if signed && (a.range.signed().0 < 0 || b.range.signed().0 < 0) => Range::ALL,
                    _ => a.range.divide(b.range),
                };
                let mut value = Value::within(range);
                if !signed && range.as_constant().is_none() {
                    let symbol = self.symbols.define(Definition::Quotient { of: a, by: b });
                    value.base = Some((symbol, Range::constant(0)));
                }
                self.set(state, rd, value);
            }
            Insn::HalfMul { rd, ra, op, .. } => {
                self.set(state, rd, Value::ANY);
                if op == rsemu::cpu::arm::v7m::isa::HalfMulOp::Smlal {
                    self.set(state, ra, Value::ANY);
                }
            }
            Insn::DualMul { rd, ra, op, .. } => {
                self.set(state, rd, Value::ANY);
                use rsemu::cpu::arm::v7m::isa::DualMulOp;
                if matches!(op, DualMulOp::Smlald | DualMulOp::Smlsld) {
                    self.set(state, ra, Value::ANY);
                }
            }
            Insn::Sat {
                unsigned,
                halves,
                rd,
                imm,
                ..
            } => {
                let range = match (unsigned, halves) {
                    (_, true) => Range::ALL,
                    (true, false) => Range::between(0, ((1u64 << imm) - 1) as u32),
                    (false, false) => {
                        let half = 1u64 << (imm - 1);
                        Range::arc((half as u32).wrapping_neg(), (2 * half - 1) as u32, 1)
                    }
                };
                self.set(state, rd, Value::within(range));
            }
            Insn::SatQ { rd, .. }
            | Insn::Simd { rd, .. }
            | Insn::Sel { rd, .. }
            | Insn::Usad { rd, .. }
            | Insn::Pkh { rd, .. } => self.set(state, rd, Value::ANY),
            Insn::Extend {
                op,
                rd,
                rn,
                rm,
                rotate,
            } => {
                let source = read(state, rm);
                let extended = if rotate == 0 {
                    extend(op, &source)
                } else if let Some(value) = source.as_constant() {
                    extend(op, &Value::constant(value.rotate_right(u32::from(rotate))))
                } else {
                    extend(op, &Value::ANY)
                };
                let result = if rn == 15 {
                    extended
                } else if matches!(op, ExtendOp::Sxtb16 | ExtendOp::Uxtb16) {
                    Value::ANY
                } else {
                    read(state, rn).add(&extended)
                };
                self.set(state, rd, result);
            }
            Insn::Misc { op, rd, rm } => {
                let value = read(state, rm);
                let range = match (op, value.as_constant()) {
                    (MiscOp::Clz, Some(x)) => Range::constant(x.leading_zeros()),
                    (MiscOp::Clz, None) => {
                        let (low, high) = value.range.unsigned();
                        Range::between(high.leading_zeros(), low.leading_zeros())
                    }
                    (MiscOp::Rbit, Some(x)) => Range::constant(x.reverse_bits()),
                    (MiscOp::Rev, Some(x)) => Range::constant(x.swap_bytes()),
                    (MiscOp::Rev16, Some(x)) => {
                        Range::constant(((x >> 8) & 0x00ff_00ff) | ((x << 8) & 0xff00_ff00))
                    }
                    _ => Range::ALL,
                };
                self.set(state, rd, Value::within(range));
            }
            Insn::Bitfield {
                op,
                rd,
                rn,
                lsb,
                width,
            } => {
                let result = match op {
                    BitfieldOp::Ubfx => field(&read(state, rn), lsb, width),
                    BitfieldOp::Sbfx => {
                        let left = 32 - u32::from(lsb) - u32::from(width);
                        let range = read(state, rn)
                            .range
                            .shift_left(left)
                            .shift_right_signed(left + u32::from(lsb));
                        Value::within(range)
                    }
                    BitfieldOp::Bfi | BitfieldOp::Bfc => {
                        let mask = (((1u64 << width) - 1) << lsb) as u32;
                        let kept = read(state, rd).range.and(Range::constant(!mask));
                        let new = if op == BitfieldOp::Bfc {
                            Range::constant(0)
                        } else {
                            field(&read(state, rn), 0, width)
                                .range
                                .shift_left(u32::from(lsb))
                        };
                        Value::within(match (kept.as_constant(), new.as_constant()) {
                            (Some(a), Some(b)) => Range::constant(a | b),
                            _ => kept.or(new),
                        })
                    }
                };
                self.set(state, rd, result);
            }
            Insn::Mrs { rd, sysm } => {
                let value = match sysm {
                    16 => match state.primask {
                        Some(masked) => Value::constant(u32::from(masked)),
                        None => Value::within(Range::between(0, 1)),
                    },
                    17 | 18 => state.basepri,
                    _ => Value::ANY,
                };
                self.set(state, rd, value);
            }
            Insn::Msr { rn, sysm, .. } => {
                let value = read(state, rn);
                match sysm {
                    // APSR and its combinations.
                    0..=3 => state.flags = Flags::ANY,
                    16 => set_primask(
                        state,
                        value.as_constant().map(|v| v & 1 != 0),
                        instruction.address,
                        &mut effects,
                    ),
                    17 | 18 => set_basepri(state, &value, sysm == 18, instruction, &mut effects),
                    _ => {}
                }
            }
            Insn::Cps {
                enable, i: true, ..
            } => set_primask(state, Some(!enable), instruction.address, &mut effects),
            Insn::Fp(insn) => self.floating_point(state, insn, pc, &mut effects),
            // Everything that neither moves data nor control, and what the
            // targets do not have: registers stay, or the path ends.
            _ => {}
        }
        effects
    }

    fn floating_point(&mut self, state: &mut State, insn: FpInsn, pc: u32, effects: &mut Effects) {
        let set = |state: &mut State, register: u8, value: Value| {
            let index = usize::from(register & 31);
            if state.floats[index] != value {
                Rc::make_mut(&mut state.floats)[index] = value;
            }
        };
        match insn {
            FpInsn::MovCore { to_fp, rt, n } => {
                if to_fp {
                    let value = state.registers[usize::from(rt).min(14)];
                    set(state, n, value);
                } else {
                    let value = state.floats[usize::from(n & 31)];
                    self.set(state, rt, value);
                }
            }
            FpInsn::MovCore2 {
                to_fp, rt, rt2, m, ..
            } => {
                for (core, float) in [(rt, m), (rt2, m + 1)] {
                    if to_fp {
                        let value = state.registers[usize::from(core).min(14)];
                        set(state, float, value);
                    } else {
                        let value = state.floats[usize::from(float & 31)];
                        self.set(state, core, value);
                    }
                }
            }
            FpInsn::MovImm { d, imm } => set(state, d, Value::constant(imm)),
            FpInsn::Unary {
                op: UnaryOp::Mov,
                d,
                m,
            } => {
                let value = state.floats[usize::from(m & 31)];
                set(state, d, value);
            }
            FpInsn::Sys { to_core, rt, .. } => {
                if to_core && rt == 15 {
                    state.flags = Flags::ANY;
                } else if to_core {
                    self.set(state, rt, Value::ANY);
                }
            }
            FpInsn::Mem {
                load,
                d,
                rn,
                imm,
                add,
                double,
            } => {
                let base = if rn == 15 {
                    Value::constant(pc & !3)
                } else {
                    state.registers[usize::from(rn)]
                };
                let address = if add {
                    base.add(&Value::constant(imm))
                } else {
                    base.subtract(&Value::constant(imm))
                };
                let count = if double { 2 } else { 1 };
                self.move_floats(state, load, d, &address, count, effects);
            }
            FpInsn::Multi {
                load,
                d,
                rn,
                count,
                add,
                writeback,
                ..
            } => {
                let base = state.registers[usize::from(rn).min(14)];
                let bytes = Value::constant(4 * u32::from(count));
                let (start, end) = if add {
                    (base, base.add(&bytes))
                } else {
                    let start = base.subtract(&bytes);
                    (start, start)
                };
                self.move_floats(state, load, d, &start, u32::from(count), effects);
                if writeback {
                    self.set(state, rn, end);
                }
            }
            FpInsn::Data { d, .. }
            | FpInsn::Unary { d, .. }
            | FpInsn::CvtInt { d, .. }
            | FpInsn::CvtMode { d, .. }
            | FpInsn::RintMode { d, .. }
            | FpInsn::CvtFixed { d, .. }
            | FpInsn::CvtHalf { d, .. }
            | FpInsn::Sel { d, .. } => set(state, d, Value::ANY),
            FpInsn::Cmp { .. } => {}
        }
    }

    fn move_floats(
        &mut self,
        state: &mut State,
        load: bool,
        first: u8,
        address: &Value,
        count: u32,
        effects: &mut Effects,
    ) {
        effects.access = Some(Access {
            address: address.range,
            load,
            size: 4,
            count,
        });
        for position in 0..count {
            let at = address.add(&Value::constant(4 * position));
            let index = usize::from(first) + position as usize;
            if index >= 32 {
                break;
            }
            if load {
                let value = self.load(state, &at, 4, false);
                let value = self.named(value);
                Rc::make_mut(&mut state.floats)[index] = value;
            } else {
                let value = state.floats[index];
                self.store(state, &at, 4, &value);
            }
        }
    }

    /// Keeps track of a division by a constant: product, then shift.
    fn scale(&mut self, value: &Value, by: Shift, result: &mut Value) {
        if by.ty != ShiftType::Lsr || result.as_constant().is_some() {
            return;
        }
        if let Some(Definition::Scaled { of, factor, shift }) = self.symbols.definition(value) {
            let definition = Definition::Scaled {
                of: *of,
                factor: *factor,
                shift: shift + u32::from(by.amount),
            };
            result.base = Some((self.symbols.define(definition), Range::constant(0)));
        }
    }

    fn named(&mut self, mut value: Value) -> Value {
        if value.base.is_none() && value.as_constant().is_none() {
            value.base = Some((self.symbols.fresh(), Range::constant(0)));
        }
        value
    }

    fn set(&mut self, state: &mut State, register: u8, value: Value) {
        let value = self.named(value);
        match register {
            13 => {
                if let (Some(old), Some(new)) = (state.stack_pointer(), value.as_constant())
                    && new > old
                {
                    state.drop_below(new);
                }
                state.registers[13] = value;
            }
            0..=14 => state.registers[usize::from(register)] = value,
            _ => {}
        }
    }

    fn load(&mut self, state: &State, address: &Value, size: u32, signed: bool) -> Value {
        if let Some(at) = address.as_constant()
            && STACK.contains(at)
        {
            return match state.load_stack(at, size) {
                Some(value) if size == 4 => value,
                Some(value) => match size {
                    1 if signed => extend(ExtendOp::Sxtb, &value),
                    1 => extend(ExtendOp::Uxtb, &value),
                    _ if signed => extend(ExtendOp::Sxth, &value),
                    _ => extend(ExtendOp::Uxth, &value),
                },
                // Never written on this path: whatever is made of it, it is
                // no address that the program may use.
                None => unknown(size, signed),
            };
        }
        let constants = |addresses: &mut dyn Iterator<Item = u32>| -> Option<Vec<u32>> {
            addresses
                .map(|at| Some(adjust(self.constant(state, at, size)?, size, signed)))
                .collect()
        };
        let words = match self.symbols.elements(address) {
            Some(addresses) => constants(&mut addresses.into_iter()),
            None if address.range.count() <= MAX_LOADS => constants(&mut address.range.iter()),
            None => None,
        };
        if let Some(value) = words.and_then(|words| self.symbols.one_of(words)) {
            return value;
        }
        let on_stack = address.range.meet(STACK).is_some() && (address.stack || state.escaped);
        Value {
            stack: size == 4 && (on_stack || state.escaped),
            ..unknown(size, signed)
        }
    }

    /// What is at `address`, if that never changes or has not yet.
    fn constant(&self, state: &State, address: u32, size: u32) -> Option<u32> {
        self.image.constant(address, size).or_else(|| {
            let within = address & 3;
            let words = if state.started {
                &self.memory.lasting
            } else {
                &state.memory
            };
            let word = words
                .get(&(address - within))
                .filter(|_| within + size <= 4)?
                >> (8 * within);
            Some(if size == 4 {
                word
            } else {
                word & ((1 << (8 * size)) - 1)
            })
        })
    }

    /// Whether a store to `address` cannot reach the stack, as it is made
    /// within a static variable.
    fn elsewhere(&self, address: &Value) -> bool {
        let told = matches!(self.memory.target, Some(Some(to)) if to != EVERYWHERE);
        let far = address.range.span() >= FAR;
        far && told || self.symbols.origin(address).is_some()
    }

    /// Takes account of a store outside the stack.
    fn note(&mut self, state: &mut State, address: &Value, size: u32, value: &Value) {
        let reached = match reach(&self.symbols, address, size) {
            Some(EVERYWHERE) => self.memory.target.unwrap_or(Some(EVERYWHERE)),
            other => other,
        };
        let Some((first, last)) = reached else { return };
        if state.started {
            self.memory.written.insert((first, last));
            return;
        }
        let word = value.as_constant().filter(|word| {
            let exact = address.as_constant() == Some(first) && first & 3 == 0;
            size == 4 && exact && !value.stack && leads_to_memory(*word)
        });
        let near = first.saturating_sub(3)..=last;
        if !RAM.contains(first) && last - first < FAR {
            return;
        }
        let touched = state.memory.range(near).next().is_some();
        if touched || word.is_some() {
            let memory = Rc::make_mut(&mut state.memory);
            memory.retain(|at, _| *at < first.saturating_sub(3) || *at > last);
            memory.extend(word.map(|word| (first, word)));
        }
    }

    /// What a peripheral is told the address of, it may write to.
    fn lend(&mut self, address: &Value, value: &Value) {
        let told = address
            .as_constant()
            .is_some_and(|at| PERIPHERALS.contains(at));
        let Some(lent) = value.as_constant().filter(|_| told) else {
            return;
        };
        match self.image.variables().around(lent) {
            Some(variable) => _ = self.memory.written.insert(variable),
            None if FITTED.iter().any(|ram| ram.contains(lent)) => {
                self.memory.written.insert(EVERYWHERE);
            }
            None => {}
        }
    }

    fn store(&mut self, state: &mut State, address: &Value, size: u32, value: &Value) {
        self.note(state, address, size, value);
        self.lend(address, value);
        if let Some(at) = address.as_constant()
            && STACK.contains(at)
        {
            let kept = match size {
                1 => extend(ExtendOp::Uxtb, value),
                2 => extend(ExtendOp::Uxth, value),
                _ => *value,
            };
            let kept = self.named(kept);
            state.store_stack(at, size, kept);
            return;
        }
        let pointer = value.stack && value.range.meet(STACK).is_some() && size == 4;
        if self.elsewhere(address) {
            state.escaped |= pointer;
            return;
        }
        if address.range.meet(STACK).is_some() && (address.stack || state.escaped) {
            if let Some(places) = places(&self.symbols, address) {
                for at in places.into_iter().filter(|at| STACK.contains(*at)) {
                    state.weaken_stack(Range::constant(at), size, pointer);
                }
                return;
            }
            let within = if address.range.span() > STACK.span() {
                STACK
            } else {
                address.range
            };
            state.weaken_stack(within, size, pointer);
        } else if pointer {
            // An address on the stack now lies where loads are not tracked.
            state.escaped = true;
        }
    }
}

/// `dividend - a * b` when one factor is the dividend's quotient by the other.
fn remainder(symbols: &Symbols, dividend: &Value, a: &Value, b: &Value) -> Option<Value> {
    let same = |of: &Value| of.base.is_some() && of.base == dividend.base;
    let below = |divisor: u32| {
        let (_, high) = dividend.range.unsigned();
        Value::within(Range::between(0, high.min(divisor.max(1) - 1)))
    };
    for (quotient, divisor) in [(a, b), (b, a)] {
        match symbols.definition(quotient) {
            Some(Definition::Quotient { of, by }) if same(of) => {
                let equal = by.base.is_some() && by.base == divisor.base
                    || by.as_constant().is_some() && by.as_constant() == divisor.as_constant();
                // Divided by zero the core gives zero: the dividend remains.
                if equal && !by.range.contains(0) {
                    return Some(below(by.range.unsigned().1));
                }
            }
            Some(Definition::Scaled { of, factor, shift }) if same(of) => {
                let divisor = divisor.as_constant()?;
                if divides(divisor, *factor, *shift) {
                    return Some(below(divisor));
                }
            }
            _ => {}
        }
    }
    None
}

/// Whether `(n * factor) >> shift` is `n / divisor` for every 32-bit `n`
/// (Granlund and Montgomery 1994, theorem 4.2).
fn divides(divisor: u32, factor: u32, shift: u32) -> bool {
    if divisor == 0 || !(32..64).contains(&shift) {
        return false;
    }
    let power = 1u128 << shift;
    let product = u128::from(divisor) * u128::from(factor);
    product >= power && product - power <= 1 << (shift - 32)
}

/// A loaded word of which nothing is known but its size.
fn unknown(size: u32, signed: bool) -> Value {
    Value::within(match (size, signed) {
        (1, false) => Range::between(0, 0xff),
        (1, true) => Range::arc(0xffff_ff80, 0xff, 1),
        (2, false) => Range::between(0, 0xffff),
        (2, true) => Range::arc(0xffff_8000, 0xffff, 1),
        _ => Range::ALL,
    })
}

fn adjust(word: u32, size: u32, signed: bool) -> u32 {
    match (size, signed) {
        (1, true) => i32::from(word as u8 as i8) as u32,
        (2, true) => i32::from(word as u16 as i16) as u32,
        _ => word,
    }
}

fn extend(op: ExtendOp, value: &Value) -> Value {
    let (low, high) = value.range.unsigned();
    let (least, most) = value.range.signed();
    let (fits, size, signed) = match op {
        ExtendOp::Uxtb => (high <= 0xff, 1, false),
        ExtendOp::Uxth => (high <= 0xffff, 2, false),
        ExtendOp::Sxtb => (least >= -0x80 && most <= 0x7f, 1, true),
        ExtendOp::Sxth => (least >= -0x8000 && most <= 0x7fff, 2, true),
        ExtendOp::Sxtb16 | ExtendOp::Uxtb16 => return Value::ANY,
    };
    if fits {
        return *value;
    }
    if let Some(word) = value.as_constant() {
        let mask = if size == 1 { 0xff } else { 0xffff };
        return Value::constant(adjust(word & mask, size, signed));
    }
    let _ = low;
    unknown(size, signed)
}

fn field(value: &Value, lsb: u8, width: u8) -> Value {
    let shifted = value.range.shift_right(u32::from(lsb));
    let mask = ((1u64 << width) - 1) as u32;
    if lsb == 0 && value.range.unsigned().1 <= mask {
        return *value;
    }
    Value::within(shifted.and(Range::constant(mask)))
}

fn shifted(value: &Value, shift: Shift) -> Value {
    if shift.is_none() {
        return *value;
    }
    let amount = u32::from(shift.amount);
    let range = match shift.ty {
        ShiftType::Lsl => value.range.shift_left(amount),
        ShiftType::Lsr if amount >= 32 => Range::constant(0),
        ShiftType::Lsr => value.range.shift_right(amount),
        ShiftType::Asr => value.range.shift_right_signed(amount.min(31)),
        ShiftType::Ror => match value.as_constant() {
            Some(word) => Range::constant(word.rotate_right(amount)),
            None => Range::ALL,
        },
        ShiftType::Rrx => Range::ALL,
    };
    Value::with_range(range, &[value])
}

fn data_processing(op: DpOp, first: &Value, second: &Value, carry: Option<bool>) -> Value {
    let bitwise = |range: Range| Value::with_range(range, &[first, second]);
    match op {
        DpOp::Mov => *second,
        DpOp::Mvn => Value::within(match second.as_constant() {
            Some(word) => Range::constant(!word),
            // Not x is -x - 1.
            None => second.range.negate().subtract(Range::constant(1)),
        }),
        DpOp::Add | DpOp::Cmn => first.add(second),
        DpOp::Sub | DpOp::Cmp => first.subtract(second),
        DpOp::Rsb => second.subtract(first),
        DpOp::Adc => {
            let carry = carry.map_or(Range::between(0, 1), |c| Range::constant(u32::from(c)));
            first.add(second).add(&Value::within(carry))
        }
        DpOp::Sbc => {
            let borrow = carry.map_or(Range::between(0, 1), |c| Range::constant(u32::from(!c)));
            first.subtract(second).subtract(&Value::within(borrow))
        }
        DpOp::And | DpOp::Tst => {
            let range = first.range.and(second.range);
            if range == first.range && second.as_constant().is_some() {
                *first
            } else {
                aligned_stack(first, second, bitwise(range))
            }
        }
        DpOp::Bic => match second.as_constant() {
            Some(mask) => {
                let kept = Value::constant(!mask);
                aligned_stack(first, &kept, bitwise(first.range.and(kept.range)))
            }
            None => bitwise(Range::between(0, first.range.unsigned().1)),
        },
        DpOp::Orr => {
            if second.as_constant() == Some(0) {
                *first
            } else {
                bitwise(first.range.or(second.range))
            }
        }
        DpOp::Orn => match (first.as_constant(), second.as_constant()) {
            (Some(a), Some(b)) => Value::constant(a | !b),
            _ => bitwise(Range::ALL),
        },
        DpOp::Eor | DpOp::Teq => bitwise(first.range.xor(second.range)),
    }
}

/// Masking an address on the stack beyond its known alignment of eight bytes
/// must not use the pretended address.
fn aligned_stack(first: &Value, mask: &Value, result: Value) -> Value {
    let stack = first.stack && first.range.meet(STACK).is_some();
    match mask.as_constant() {
        Some(mask) if stack && mask & !7 != !7 && mask & !7 != 0 => {
            let cleared = !mask;
            match first.as_constant() {
                // Moved down by less than the alignment asked for.
                Some(address) if cleared & cleared.wrapping_add(1) == 0 && cleared < 0x1_0000 => {
                    Value {
                        range: Range::arc(
                            (address & !7).wrapping_sub(cleared & !7),
                            cleared & !7,
                            8,
                        ),
                        base: None,
                        stack: true,
                    }
                }
                _ => Value {
                    range: Range::ALL,
                    base: None,
                    stack: true,
                },
            }
        }
        _ => result,
    }
}

fn with_carry(op: DpOp, a: u32, b: u32, carry: bool) -> u32 {
    let b = if op == DpOp::Sbc { !b } else { b };
    let unsigned = u64::from(a) + u64::from(b) + u64::from(carry);
    let signed = i64::from(a as i32) + i64::from(b as i32) + i64::from(carry);
    let result = unsigned as u32;
    let mut flags = 0;
    if result >> 31 != 0 {
        flags |= 8;
    }
    if result == 0 {
        flags |= 4;
    }
    if unsigned >> 32 != 0 {
        flags |= 2;
    }
    if signed != i64::from(result as i32) {
        flags |= 1;
    }
    flags
}

fn set_primask(state: &mut State, masked: Option<bool>, at: u32, effects: &mut Effects) {
    let lift = |state: &mut State, effects: &mut Effects| {
        state.masked.retain(|mask| {
            if mask.level == 0 {
                effects.unmasked.push(*mask);
            }
            mask.level != 0
        });
    };
    match masked {
        Some(true) => {
            if !state.masked.iter().any(|mask| mask.level == 0) {
                state.masked.push(Masked {
                    level: 0,
                    cycles: [0; 2],
                    at,
                });
            }
        }
        Some(false) => {
            lift(state, effects);
            state.started = true;
        }
        None => effects.unknown_mask = true,
    }
    state.primask = masked;
}

fn set_basepri(
    state: &mut State,
    value: &Value,
    only_raise: bool,
    instruction: &Instruction,
    effects: &mut Effects,
) {
    let restored = match (value.base, state.basepri.base) {
        // Back to a word read from the register earlier.
        (Some((symbol, _)), _) if value.as_constant().is_none() => Some(symbol),
        _ => None,
    };
    if let Some(level) = value.as_constant() {
        let level = level as u8;
        let lower = |mask: &Masked| mask.level != 0 && (level == 0 || mask.level < level);
        if !only_raise {
            effects
                .unmasked
                .extend(state.masked.iter().filter(|mask| lower(mask)));
            state.masked.retain(|mask| !lower(mask));
        }
        if level != 0
            && !state
                .masked
                .iter()
                .any(|mask| mask.level != 0 && mask.level <= level)
        {
            state.masked.push(Masked {
                level,
                cycles: [0; 2],
                at: instruction.address,
            });
        }
        state.basepri = *value;
    } else if restored.is_some() {
        // The only unknown word that is ever written back is the one found
        // on entry, which masks nothing that this task could be.
        effects
            .unmasked
            .extend(state.masked.iter().filter(|mask| mask.level != 0));
        state.masked.retain(|mask| mask.level == 0);
        state.basepri = *value;
    } else {
        effects.unknown_mask = true;
    }
}
