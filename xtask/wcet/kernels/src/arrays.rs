//! Loops over arrays.

use crate::Input;

/// Three nested loops.
#[inline(never)]
pub fn nested(input: &mut Input) -> u32 {
    let mut sum = 0u32;
    for a in 0..5 {
        for b in 0..6 {
            for c in 0..7 {
                sum = sum.wrapping_mul(31).wrapping_add(input[a * b + c]);
            }
        }
    }
    sum
}

/// An inner loop that runs up to the outer counter.
#[inline(never)]
pub fn triangular(input: &mut Input) -> u32 {
    let mut sum = 0u32;
    for a in 0..40 {
        for b in 0..a {
            sum = sum.rotate_left(3) ^ input[b];
        }
        input[a] = sum;
    }
    sum
}

/// Product of two 4 by 4 matrices of floats.
#[inline(never)]
pub fn matrix_f32(input: &mut Input) -> u32 {
    let mut product = [0.0f32; 16];
    for row in 0..4 {
        for column in 0..4 {
            for k in 0..4 {
                product[4 * row + column] +=
                    f32::from_bits(input[4 * row + k]) * f32::from_bits(input[16 + 4 * k + column]);
            }
        }
    }
    for (word, element) in input.iter_mut().zip(product) {
        *word = element.to_bits();
    }
    input[5]
}

/// Product of two 5 by 5 matrices of integers.
#[inline(never)]
pub fn matrix_i32(input: &mut Input) -> u32 {
    let mut trace = 0u32;
    for row in 0..5 {
        for column in 0..5 {
            let mut sum = 0u32;
            for k in 0..5 {
                sum = sum.wrapping_add(input[5 * row + k].wrapping_mul(input[25 + 5 * k + column]));
            }
            if row == column {
                trace = trace.wrapping_add(sum);
            }
        }
    }
    trace
}

/// Insertion sort of 24 words.
#[inline(never)]
pub fn insertion_sort(input: &mut Input) -> u32 {
    let words = &mut input[..24];
    for next in 1..words.len() {
        let mut at = next;
        while at > 0 && words[at - 1] > words[at] {
            words.swap(at - 1, at);
            at -= 1;
        }
    }
    words[0]
}

/// Bubble sort of 16 words.
#[inline(never)]
pub fn bubble_sort(input: &mut Input) -> u32 {
    let words = &mut input[..16];
    for end in (1..words.len()).rev() {
        for at in 0..end {
            if words[at] > words[at + 1] {
                words.swap(at, at + 1);
            }
        }
    }
    words[15]
}

/// Heap sort of 32 words.
#[inline(never)]
pub fn heap_sort(input: &mut Input) -> u32 {
    fn sink(words: &mut [u32; 32], mut at: usize, end: usize) {
        // loop-bound: 5 the heap has five levels
        loop {
            let mut child = 2 * at + 1;
            if child >= end {
                break;
            }
            if child + 1 < end && words[child] < words[child + 1] {
                child += 1;
            }
            if words[at] >= words[child] {
                break;
            }
            words.swap(at, child);
            at = child;
        }
    }
    let mut words = [0u32; 32];
    words.copy_from_slice(&input[..32]);
    for at in (0..16).rev() {
        sink(&mut words, at, 32);
    }
    for end in (1..32).rev() {
        words.swap(0, end);
        sink(&mut words, 0, end);
    }
    words[31] ^ words[7]
}

/// Binary search in a sorted table.
#[inline(never)]
pub fn binary_search(input: &mut Input) -> u32 {
    static TABLE: [u32; 33] = {
        let mut table = [0; 33];
        let mut at = 0;
        while at < 33 {
            table[at] = (at as u32) * 130_000_000;
            at += 1;
        }
        table
    };
    let mut found = 0;
    for word in &input[..4] {
        found = found * 64 + TABLE.partition_point(|entry| entry < word) as u32;
    }
    found
}

/// A copy whose length depends on the input, up to 100 bytes.
#[inline(never)]
pub fn copy_some(input: &mut Input) -> u32 {
    let mut bytes = [0u8; 100];
    let mut source = [0u8; 100];
    for (byte, word) in source.iter_mut().zip(input.iter()) {
        *byte = *word as u8;
    }
    let length = input[0].min(100) as usize;
    bytes[..length].copy_from_slice(&source[..length]);
    bytes.iter().map(|byte| u32::from(*byte)).sum()
}

/// A comparison of a length that is in the input, of texts that differ in one byte or none.
#[inline(never)]
pub fn compare_some(input: &mut Input) -> u32 {
    let mut first = [0u8; 60];
    for (byte, word) in first.iter_mut().zip(input.iter()) {
        *byte = *word as u8;
    }
    let mut second = first;
    second[input[1].min(59) as usize] ^= input[2] as u8;
    let length = input[0].min(60) as usize;
    first[..length].cmp(&second[..length]) as u32
}

/// A copy of fixed length.
#[inline(never)]
pub fn copy_all(input: &mut Input) -> u32 {
    let copy = *input;
    for (word, other) in input.iter_mut().zip(copy.iter().rev()) {
        *word ^= other;
    }
    input[3]
}

/// Primes below 128.
#[inline(never)]
pub fn sieve(input: &mut Input) -> u32 {
    let mut composite = [false; 128];
    let mut primes = input[0] & 1;
    for number in 2..128 {
        if !composite[number] {
            primes += 1;
            let mut multiple = number * number;
            // loop-bound: 62 the multiples of two from four
            while multiple < 128 {
                composite[multiple] = true;
                multiple += number;
            }
        }
    }
    primes
}

/// Median of nine, by counting.
#[inline(never)]
pub fn median(input: &mut Input) -> u32 {
    let words = &input[..9];
    for candidate in words {
        let below = words.iter().filter(|word| *word < candidate).count();
        let not_above = words.iter().filter(|word| *word <= candidate).count();
        if below <= 4 && not_above > 4 {
            return *candidate;
        }
    }
    0
}

/// Fills as many words of the block as its first word says.
#[inline(never)]
pub fn fill_some(input: &mut Input) -> u32 {
    let count = (input[0] & 63) as usize;
    let value = input[1];
    let part = input.get_mut(..count).unwrap_or_default();
    // loop-bound: 63 the largest count
    part.fill(value);
    part.len() as u32
}
