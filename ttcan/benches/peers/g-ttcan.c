/* G-TTCAN with a schedule of equal slots: node 2 of three, which is not master and sends in each third slot. */
#include "gttcan.h"
#include "program.h"

static gttcan_t node;
static global_schedule_entry_t schedule[512];
static uint16_t slots;

static void transmit(uint32_t identifier, uint64_t data) { sent = identifier + (uint32_t)data + 1; }
static void set_timer(uint32_t time) { timer = time; }
static uint64_t read_value(uint16_t name) { return name; }
static void write_value(uint16_t name, uint64_t data) { written = name + (uint32_t)data; }

static void receive(uint16_t slot)
{
    gttcan_process_frame(&node, ((uint32_t)slot << GTTCAN_NUM_DATA_ID_BITS) | schedule[slot].data_id, 0x1234);
}

/* One round, as the bus has it. */
static void round_of_frames(uint16_t until)
{
    for (uint16_t slot = 0; slot < until; slot++) {
        if (schedule[slot].node_id == 2) {
            gttcan_transmit_next_frame(&node);
        } else {
            receive(slot);
        }
    }
}

void prepare(uint16_t windows, enum event event)
{
    slots = windows;
    for (uint16_t slot = 0; slot < windows; slot++) {
        schedule[slot].node_id = slot % 3 + 1;
        schedule[slot].slot_id = slot;
        schedule[slot].data_id = slot == 0 ? REFERENCE_FRAME_DATA_ID : GENERIC_DATA_ID;
    }
    gttcan_init(&node, 2, schedule, windows, 1000, 10, transmit, set_timer, read_value, write_value, true);
    gttcan_start(&node);
    for (int round = 0; round < 4; round++) {
        round_of_frames(windows);
    }
    /* The event is the last slot but one, the first, or the second. */
    round_of_frames(event == DATA ? windows - (schedule[windows - 1].node_id == 2 ? 2 : 1) : event == WINDOW);
}

void handle(enum event event)
{
    switch (event) {
    case DATA: receive(slots - (schedule[slots - 1].node_id == 2 ? 2 : 1)); break;
    case REFERENCE: receive(0); break;
    case WINDOW: gttcan_transmit_next_frame(&node); break;
    }
}
