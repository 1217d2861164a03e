#!/bin/sh
# Builds kernels.rs, runs it on QEMU's Cortex-M4 and writes both down: image.hex is the
# program, results.hex what QEMU left in memory. Wants rustc with the target
# thumbv7em-none-eabihf and qemu-system-arm (Debian: the package of that name).
set -eu
cd "$(dirname "$0")"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
rustc --edition 2024 --target thumbv7em-none-eabihf --crate-name kernels \
    -C opt-level=2 -C panic=abort -C codegen-units=1 -C overflow-checks=off \
    -C linker=rust-lld -C linker-flavor=ld.lld \
    -C link-arg=-Tlink.x -C link-arg=--oformat=binary -o "$work/image" kernels.rs
# netduinoplus2 is an STM32F405: flash and RAM are where the STM32F446 has them.
{
    sleep 3
    printf 'stop\npmemsave 0x20004000 8192 "%s"\nquit\n' "$work/results"
} | qemu-system-arm -M netduinoplus2 -display none -serial none -monitor stdio \
    -kernel "$work/image" >/dev/null
words=$(od -An -tu4 -N4 "$work/results" | tr -d ' ')
[ "$words" -gt 0 ] || { echo "the program did not come to its end on QEMU" >&2; exit 1; }
hex() { od -An -v -tx4 -w32 | sed 's/^ //'; }
hex <"$work/image" >image.hex
head -c $((4 * (words + 1))) "$work/results" | hex >results.hex
echo "image: $(wc -c <"$work/image") bytes, results: $words words"
