/*
 * What surrounds a peer's sources, so that `cargo xtask bench --elf` can call them: a vector table, a loop
 * at 0x08000008 in which the program waits, and the functions that prepare and run an event.
 */
#include "program.h"

/* Initial stack pointer, reset vector, and the waiting place itself (`b .`, twice). */
__asm__(".section .vectors, \"ax\"\n"
        ".thumb\n"
        ".word 0x20020000\n"
        ".word 0x08000009\n"
        "b .\n"
        "b .\n");

/* What the stack has asked for. Volatile, so that nothing is left out. */
volatile uint32_t timer, sent, written;
static volatile enum event event;

static uint32_t happened(void) { return timer + sent + written; }

#define PREPARE(size, windows, name, kind)                   \
    void prepare_##size##_##name(void)                       \
    {                                                        \
        prepare(windows, kind);                              \
        event = kind;                                        \
        timer = sent = written = 0;                          \
    }

PREPARE(few, 8, data, DATA)
PREPARE(few, 8, reference, REFERENCE)
PREPARE(few, 8, window, WINDOW)
PREPARE(many, 512, data, DATA)
PREPARE(many, 512, reference, REFERENCE)
PREPARE(many, 512, window, WINDOW)

static uint32_t run(void)
{
    handle(event);
    return happened() != 0;
}

uint32_t run_few(void) { return run(); }
uint32_t run_many(void) { return run(); }
