//! Programs that exercise the processor and leave their results in memory. The emulated core and
//! QEMU run them, and a test compares the results word by word. `generate.sh` builds them.
//!
//! Results start at 0x2000_4000. The first word is their number of words. Each kernel adds a
//! header, with its number in the upper half and its count of words in the lower half, and then its
//! words.

#![no_std]
#![no_main]

use core::arch::{asm, global_asm};
use core::panic::PanicInfo;
use core::ptr::{addr_of, addr_of_mut, read_volatile, write_volatile};

global_asm!(
    ".section .vectors, \"a\"",
    ".word 0x20008000",
    ".word start",
    ".word hang, hang, hang, hang, hang, 0, 0, 0, 0",
    ".word supervisor, hang, 0, pended, hang",
    ".text",
    ".thumb_func",
    ".global start",
    "start:",
    // Switch the floating-point unit on (CPACR).
    "ldr r0, =0xE000ED88",
    "mov r1, #0x00F00000",
    "str r1, [r0]",
    "dsb",
    "isb",
    "bl main",
    ".thumb_func",
    ".global hang",
    "hang:",
    "b hang",
);

const RESULTS: *mut u32 = 0x2000_4000 as *mut u32;

struct Results {
    next: usize,
    head: usize,
}

impl Results {
    fn begin(&mut self, kernel: u32) {
        self.head = self.next;
        self.store(self.head, kernel << 16);
        self.next += 1;
    }

    fn push(&mut self, value: u32) {
        self.store(self.next, value);
        self.next += 1;
        // SAFETY: `head` is the index of the current kernel's header, which was written before.
        let head = unsafe { read_volatile(RESULTS.add(self.head)) };
        self.store(self.head, head + 1);
    }

    fn push64(&mut self, value: u64) {
        self.push(value as u32);
        self.push((value >> 32) as u32);
    }

    fn store(&self, at: usize, value: u32) {
        // SAFETY: nothing else uses this RAM.
        unsafe { write_volatile(RESULTS.add(at), value) }
    }
}

struct Random(u32);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    fn wide(&mut self) -> u64 {
        u64::from(self.next()) << 32 | u64::from(self.next())
    }
}

fn division(r: &mut Results) {
    let mut random = Random(1);
    for k in 0..12 {
        let (a, b) = (random.wide(), random.wide() >> (5 * k));
        let b = b.max(1);
        r.push64(a / b);
        r.push64(a % b);
        r.push64(((a as i64).wrapping_div(b as i64 | 1)) as u64);
    }
    for (a, b) in [(7_u32, 2_u32), (7, 0), (0x8000_0000, 0xFFFF_FFFF), (1, 3)] {
        let (q, s): (u32, u32);
        // SAFETY: the instructions use registers only.
        unsafe {
            asm!("udiv {q}, {a}, {b}", "sdiv {s}, {a}, {b}",
                 q = out(reg) q, s = out(reg) s, a = in(reg) a, b = in(reg) b);
        }
        r.push(q);
        r.push(s);
    }
}

fn crc(r: &mut Results) {
    let mut random = Random(2);
    let mut crc = 0_u16;
    for _ in 0..300 {
        crc ^= u16::from(random.next() as u8) << 8;
        for _ in 0..8 {
            crc = if crc & 0x8000 != 0 { crc << 1 ^ 0x1021 } else { crc << 1 };
        }
    }
    r.push(u32::from(crc));
}

fn sort(r: &mut Results) {
    let mut random = Random(3);
    let mut values = [0_i32; 40];
    for value in &mut values {
        *value = random.next() as i32;
    }
    values.sort_unstable();
    for value in values {
        r.push(value as u32);
    }
}

fn floats(r: &mut Results) {
    let mut random = Random(4);
    let specials = [
        0_u32, 0x8000_0000, 0x3F80_0000, 0x7F80_0000, 0xFF80_0000, 0x7FC0_0001, 0x7F80_0001,
        0x0000_0001, 0x007F_FFFF, 0x7F7F_FFFF, 0x4F00_0000, 0xCF00_0001, 0x3F00_0000, 0xBFC0_0000,
    ];
    for k in 0..60_usize {
        let pick = |n: usize, random: &mut Random| {
            if k < 40 { specials[n % specials.len()] } else { random.next() }
        };
        let (a, b, c) = (pick(k, &mut random), pick(k * 5 + 3, &mut random), pick(k * 3 + 1, &mut random));
        let (sum, product, quotient, root, fused, chained): (u32, u32, u32, u32, u32, u32);
        let (signed, unsigned, back, flags, status): (u32, u32, u32, u32, u32);
        // SAFETY: the instructions use registers only; FPSCR is cleared first.
        unsafe {
            asm!(
                "mov {t}, #0", "vmsr fpscr, {t}",
                "vmov s0, {a}", "vmov s1, {b}", "vmov s2, {c}",
                "vadd.f32 s3, s0, s1", "vmov {sum}, s3",
                "vmul.f32 s3, s0, s1", "vmov {product}, s3",
                "vdiv.f32 s3, s0, s1", "vmov {quotient}, s3",
                t = out(reg) _, a = in(reg) a, b = in(reg) b, c = in(reg) c,
                sum = out(reg) sum, product = out(reg) product, quotient = out(reg) quotient,
                out("s0") _, out("s1") _, out("s2") _, out("s3") _,
            );
            asm!(
                "vmov s0, {a}", "vmov s1, {b}", "vmov s2, {c}",
                "vsqrt.f32 s3, s0", "vmov {root}, s3",
                "vmov.f32 s3, s2", "vfma.f32 s3, s0, s1", "vmov {fused}, s3",
                "vmov.f32 s3, s2", "vmls.f32 s3, s0, s1", "vmov {chained}, s3",
                a = in(reg) a, b = in(reg) b, c = in(reg) c,
                root = out(reg) root, fused = out(reg) fused, chained = out(reg) chained,
                out("s0") _, out("s1") _, out("s2") _, out("s3") _,
            );
            asm!(
                "vmov s0, {a}", "vmov s1, {b}",
                "vcvt.s32.f32 s3, s0", "vmov {signed}, s3",
                "vcvtr.u32.f32 s3, s0", "vmov {unsigned}, s3",
                "vcvt.f32.s32 s3, s3", "vmov {back}, s3",
                "vcmpe.f32 s0, s1", "vmrs APSR_nzcv, fpscr", "mrs {flags}, APSR",
                "vmrs {status}, fpscr",
                a = in(reg) a, b = in(reg) b,
                signed = out(reg) signed, unsigned = out(reg) unsigned, back = out(reg) back,
                flags = out(reg) flags, status = out(reg) status,
                out("s0") _, out("s1") _, out("s3") _,
            );
        }
        for value in [sum, product, quotient, root, fused, chained, signed, unsigned, back] {
            r.push(value);
        }
        r.push(flags & 0xF000_0000);
        r.push(status);
    }
}

fn doubles(r: &mut Results) {
    let mut random = Random(5);
    let mut x = 1.5_f64;
    for _ in 0..30 {
        let y = (random.next() as i32) as f64 / 65_536.0;
        x = x * y / 3.7 + y - 1.0e-3;
        x = x.clamp(-1.0e6, 1.0e6);
        r.push64(x.to_bits());
        r.push((x as f32).to_bits());
        r.push(x as i32 as u32);
    }
}

macro_rules! two {
    ($r:ident, $a:ident, $b:ident, $($text:literal),+) => {$({
        let d: u32;
        let flags: u32;
        // SAFETY: the instructions use registers only; the saturation flag is cleared first.
        unsafe {
            asm!("mov {t}, #0", "msr APSR_nzcvq, {t}", $text, "mrs {flags}, APSR @ {b}",
                 t = out(reg) _, d = out(reg) d, a = in(reg) $a, b = in(reg) $b,
                 flags = out(reg) flags);
        }
        $r.push(d);
        $r.push(flags & 0xF800_0000);
    })+};
}

fn signal(r: &mut Results) {
    let mut random = Random(6);
    for k in 0..10 {
        let (a, b) = match k {
            0 => (0x7FFF_FFFF, 0x7FFF_FFFF),
            1 => (0x8000_8000, 0x8000_8000),
            _ => (random.next(), random.next()),
        };
        two!(r, a, b,
            "qadd {d}, {a}, {b}", "qdsub {d}, {a}, {b}", "ssat {d}, #9, {a}, asr #3",
            "usat16 {d}, #7, {a}", "smulbt {d}, {a}, {b}", "smlabb {d}, {a}, {b}, {a}",
            "smuad {d}, {a}, {b}", "smlsd {d}, {a}, {b}, {b}", "smmulr {d}, {a}, {b}",
            "uqadd8 {d}, {a}, {b}", "shsub16 {d}, {a}, {b}", "sasx {d}, {a}, {b}",
            "usad8 {d}, {a}, {b}", "pkhbt {d}, {a}, {b}, lsl #5", "sxtab16 {d}, {a}, {b}, ror #8",
            "rbit {d}, {a}", "rev16 {d}, {a}", "revsh {d}, {a}", "clz {d}, {a}",
            "sbfx {d}, {a}, #5, #11", "adds {d}, {a}, {b}", "subs {d}, {a}, {b}",
            "rsbs {d}, {a}, {b}", "adcs {d}, {a}, {b}", "sbcs {d}, {a}, {b}",
            "lsls {d}, {a}, {b}", "asrs {d}, {a}, {b}", "rors {d}, {a}, {b}",
            "mul {d}, {a}, {b}", "eors {d}, {a}, {b}, lsr #7", "bics {d}, {a}, {b}, rrx"
        );
        let (low, high, selected): (u32, u32, u32);
        // SAFETY: the instructions use registers only.
        unsafe {
            asm!("mov {l}, {a}", "mov {h}, {b}", "umaal {l}, {h}, {a}, {b}",
                 "smlal {l}, {h}, {a}, {b}", "smlald {l}, {h}, {a}, {b}",
                 "usub8 {t}, {a}, {b}", "sel {s}, {a}, {b}",
                 l = out(reg) low, h = out(reg) high, t = out(reg) _, s = out(reg) selected,
                 a = in(reg) a, b = in(reg) b);
        }
        r.push(low);
        r.push(high);
        r.push(selected);
    }
}

fn jumps(r: &mut Results) {
    let mut random = Random(7);
    let mut state = 0_u32;
    let mut sum = 0_u32;
    for _ in 0..500 {
        state = match (state, random.next() & 7) {
            (0, 0..=3) => 1,
            (0, _) => 5,
            (1, n) => n,
            (2, 1 | 6) => 3,
            (2, _) => 9,
            (3, n) => 10 - n,
            (4, _) => 0,
            (5, 7) => 2,
            (5, _) => 4,
            (6, n) if n > 2 => 8,
            (7, _) => 6,
            (8, n) => n / 2,
            (9, n) => n * 3 / 2,
            _ => 7,
        };
        sum = sum.wrapping_mul(31).wrapping_add(state);
    }
    r.push(sum);
}

fn memory(r: &mut Results) {
    static mut SOURCE: [u8; 64] = [0; 64];
    static mut TARGET: [u8; 64] = [0; 64];
    let (source, target) = (addr_of_mut!(SOURCE).cast::<u8>(), addr_of_mut!(TARGET).cast::<u8>());
    for k in 0..64 {
        // SAFETY: all accesses are inside the arrays.
        unsafe { source.add(k).write_volatile((k * 37 + 11) as u8) };
    }
    for (from, to, length) in [(1, 2, 17), (3, 20, 30), (0, 51, 13)] {
        // SAFETY: all accesses are inside the arrays.
        unsafe { core::ptr::copy_nonoverlapping(source.add(from), target.add(to), length) };
    }
    for at in [1_usize, 2, 3, 5, 6, 7, 13] {
        let (word, half, signed, byte, low, high): (u32, u32, u32, u32, u32, u32);
        // SAFETY: unaligned accesses inside the arrays; LDRD on a word boundary.
        unsafe {
            asm!("ldr {w}, [{p}]", "ldrh {h}, [{p}, #1]", "ldrsh {s}, [{p}, #3]",
                 "ldrsb {b}, [{p}, #5]", "str {h}, [{p}, #9]",
                 p = in(reg) target.add(at), w = out(reg) word, h = out(reg) half,
                 s = out(reg) signed, b = out(reg) byte);
            asm!("ldrd {l}, {h}, [{p}, #8]",
                 p = in(reg) target.add(at & !3), l = out(reg) low, h = out(reg) high);
        }
        for value in [word, half, signed, byte, low, high] {
            r.push(value);
        }
    }
    // Bit-band alias of the first word of a variable.
    static mut BITS: u32 = 0;
    let bits = addr_of_mut!(BITS);
    let alias = (0x2200_0000 + (bits as u32 - 0x2000_0000) * 32) as *mut u32;
    // SAFETY: the alias addresses the bits of `BITS` (Cortex-M4 processor manual 3.7).
    unsafe {
        for bit in [0_usize, 7, 8, 31] {
            write_volatile(alias.add(bit), 1);
        }
        write_volatile(alias.add(7), 0);
        r.push(read_volatile(bits));
        r.push(read_volatile(alias.add(8)) << 1 | read_volatile(alias.add(9)));
    }
}

static mut TRACE: [u32; 64] = [0; 64];
static mut TRACED: usize = 0;

fn note(value: u32) {
    // SAFETY: there is one core, and only SVC and PendSV run. They are taken where the program
    // raises or unmasks them, never inside this function, so that no two calls overlap.
    unsafe {
        let at = read_volatile(addr_of!(TRACED));
        if at < 64 {
            write_volatile(addr_of_mut!(TRACE).cast::<u32>().add(at), value);
            write_volatile(addr_of_mut!(TRACED), at + 1);
        }
    }
}

fn ipsr() -> u32 {
    let value: u32;
    // SAFETY: only reads a register.
    unsafe { asm!("mrs {}, IPSR", out(reg) value) };
    value
}

fn exclusive_store_after(event: impl Fn()) -> u32 {
    static mut CELL: u32 = 0;
    let cell = addr_of_mut!(CELL);
    let failed: u32;
    // SAFETY: only this function uses the RAM.
    unsafe {
        asm!("ldrex {t}, [{c}]", c = in(reg) cell, t = out(reg) _);
        event();
        asm!("strex {f}, {v}, [{c}]", c = in(reg) cell, v = in(reg) 9_u32, f = out(reg) failed);
    }
    failed
}

const ICSR: *mut u32 = 0xE000_ED04 as *mut u32;
const SHPR2: *mut u32 = 0xE000_ED1C as *mut u32;
const SHPR3: *mut u32 = 0xE000_ED20 as *mut u32;
const PEND: u32 = 1 << 28;

#[unsafe(no_mangle)]
extern "C" fn supervisor() {
    note(0x1000 | ipsr());
    // SAFETY: pends PendSV, whose handler is below, and uses registers that are declared.
    unsafe {
        write_volatile(ICSR, PEND);
        asm!("dsb", "isb");
        note(0x2000 | read_volatile(ICSR) >> 12 & 0xFFF);
        // Overwrites the floating-point registers of the interrupted code.
        asm!("vmov s0, {v}", "vmov s15, {v}", "vadd.f32 s0, s0, s15",
             v = in(reg) 0x4000_0000_u32, out("s0") _, out("s15") _);
    }
    note(0x3000);
}

#[unsafe(no_mangle)]
extern "C" fn pended() {
    let priority: u32;
    // SAFETY: only reads a register.
    unsafe { asm!("mrs {}, BASEPRI", out(reg) priority) };
    note(0x4000 | ipsr() | priority << 16);
}

fn exceptions(r: &mut Results) {
    // SAFETY: sets the priorities of SVC and PendSV and raises them; their handlers are above.
    unsafe {
        for (call, pend, mask) in [(0x40, 0x80, 0), (0x80, 0x40, 0), (0x40, 0x80, 0x60), (0x40, 0x40, 0)] {
            write_volatile(SHPR2, call << 24);
            write_volatile(SHPR3, pend << 16);
            let (first, last): (u32, u32);
            asm!("msr BASEPRI, {m}", "vmov s0, {a}", "vmov s15, {b}",
                 "svc #3",
                 "dsb", "isb", "vmov {x}, s0", "vmov {y}, s15",
                 m = in(reg) mask, a = in(reg) 0x1111_1111_u32, b = in(reg) 0x2222_2222_u32,
                 x = out(reg) first, y = out(reg) last,
                 out("s0") _, out("s15") _, out("r0") _, out("r1") _, out("r2") _, out("r3") _,
                 out("r12") _, out("lr") _);
            note(0x5000);
            asm!("msr BASEPRI, {m}", "dsb", "isb", m = in(reg) 0_u32);
            note(0x6000);
            r.push(first);
            r.push(last);
        }
        // PRIMASK delays the exception until it is cleared.
        asm!("cpsid i");
        write_volatile(ICSR, PEND);
        note(0x7000);
        asm!("cpsie i", "isb");
        note(0x8000);
    }
    r.push(exclusive_store_after(|| {}));
    r.push(exclusive_store_after(|| {
        // SAFETY: an exception between the pair must make the store fail.
        unsafe {
            write_volatile(ICSR, PEND);
            asm!("dsb", "isb");
        }
    }));
    // SAFETY: no code that writes these runs any more.
    unsafe {
        r.push(read_volatile(addr_of!(TRACED)) as u32);
        for k in 0..read_volatile(addr_of!(TRACED)) {
            r.push(read_volatile(addr_of!(TRACE).cast::<u32>().add(k)));
        }
    }
}

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let mut r = Results { next: 1, head: 1 };
    let kernels: [fn(&mut Results); 9] =
        [division, crc, sort, floats, doubles, signal, jumps, memory, exceptions];
    for (number, kernel) in (1..).zip(kernels) {
        r.begin(number);
        kernel(&mut r);
    }
    r.store(0, (r.next - 1) as u32);
    loop {}
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
