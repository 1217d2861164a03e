//! Branches, jump tables and pointers.

use crate::Input;

/// Stops at the first word that is small.
#[inline(never)]
pub fn early_exit(input: &mut Input) -> u32 {
    for (index, word) in input.iter().enumerate() {
        if *word < 0x0100_0000 {
            return index as u32;
        }
    }
    64
}

/// A jump table of sixteen, eight times.
#[inline(never)]
pub fn table_jump(input: &mut Input) -> u32 {
    let mut state = input[63];
    for at in 0..8 {
        let word = input[at];
        state = match word & 15 {
            0 => state.wrapping_add(word),
            1 => state.wrapping_mul(word),
            2 => state / (word | 1),
            3 => state ^ word,
            4 => state.rotate_left(word & 31),
            5 => state.count_ones(),
            6 => state.reverse_bits(),
            7 => state.swap_bytes().wrapping_sub(word),
            8 => state % (word | 1),
            9 => !state,
            10 => state.saturating_add(word),
            11 => state.leading_zeros() + word,
            12 => state.wrapping_neg(),
            13 => (state >> 3) | word,
            14 => state & word,
            _ => word,
        };
    }
    state
}

fn double(word: u32) -> u32 {
    word.wrapping_mul(2)
}

fn root(word: u32) -> u32 {
    let mut root = 0u32;
    for bit in (0..16).rev() {
        let next = root | 1 << bit;
        if next.wrapping_mul(next) <= word {
            root = next;
        }
    }
    root
}

fn mirror(word: u32) -> u32 {
    word.reverse_bits()
}

/// Calls through a constant table of functions.
#[inline(never)]
pub fn pointer_table(input: &mut Input) -> u32 {
    static STEPS: [fn(u32) -> u32; 3] = [double, root, mirror];
    let mut word = input[0];
    for at in 1..6 {
        let step = STEPS[(input[at] % 3) as usize];
        word = step(word);
    }
    word
}

/// A parser of frames: start byte, length, payload, sum.
#[inline(never)]
pub fn state_machine(input: &mut Input) -> u32 {
    #[derive(Clone, Copy)]
    enum State {
        Idle,
        Length,
        Payload { left: u8, sum: u8 },
        Check { sum: u8 },
    }
    let mut state = State::Idle;
    let mut frames = 0;
    for word in input.iter() {
        let byte = *word as u8;
        state = match state {
            State::Idle if byte & 0x0f == 0x05 => State::Length,
            State::Idle => State::Idle,
            State::Length if byte & 7 == 0 => State::Check { sum: 0 },
            State::Length => State::Payload {
                left: byte & 7,
                sum: byte,
            },
            State::Payload { left: 1, sum } => State::Check {
                sum: sum.wrapping_add(byte),
            },
            State::Payload { left, sum } => State::Payload {
                left: left - 1,
                sum: sum.wrapping_add(byte),
            },
            State::Check { sum } => {
                frames += u32::from(sum & 3 == byte & 3);
                State::Idle
            }
        };
    }
    frames
}

/// Branches that exclude each other, and branches that depend on the turn.
#[inline(never)]
pub fn choices(input: &mut Input) -> u32 {
    let mut sum = 0u32;
    for at in 0..32 {
        let word = input[at];
        if at == 7 {
            for other in input.iter() {
                sum = sum.wrapping_add(*other / (word | 1));
            }
        } else if word & 1 == 0 {
            sum = sum.wrapping_add(word);
        } else {
            sum ^= word;
        }
    }
    sum
}

/// Counts with accesses that the compiler keeps.
#[inline(always)]
fn next(input: &mut Input, at: usize) -> u32 {
    let count = core::hint::black_box(input[at]);
    input[at] = core::hint::black_box(count.wrapping_add(1));
    count
}

/// Two loops that the compiler may let begin with the same instruction.
#[inline(never)]
pub fn merged(input: &mut Input) -> u32 {
    let mut sum = 0u32;
    // loop-bound: 4
    while next(input, 0) % 4 != 3 {
        // loop-bound: 64
        while next(input, 1) % 64 != 63 {
            sum = sum.wrapping_add(input[2]);
        }
    }
    sum
}

/// The same, of which the inner one repeats the outer one.
#[inline(never)]
pub fn repeated_from_within(input: &mut Input) -> u32 {
    let mut sum = 0u32;
    // loop-bound: 4
    'outer: loop {
        // loop-bound: 64
        loop {
            let count = next(input, 1);
            if count % 64 != 63 {
                sum = sum.wrapping_add(count);
                continue;
            }
            if next(input, 0) % 4 == 3 {
                return sum;
            }
            continue 'outer;
        }
    }
}

/// A search in a loop, whose closure has lines of its own.
#[inline(never)]
pub fn searches(input: &mut Input) -> u32 {
    let mut found = 0u32;
    // loop-bound: 4
    while next(input, 0) % 4 != 3 {
        let least = input[1] >> 4;
        let place = input.iter().position(|word| {
            let high = core::hint::black_box(*word) >> 4;
            high < least
        });
        found = found.wrapping_add(place.unwrap_or(64) as u32);
    }
    found
}
