/* GTTCan of the CPS Lab, with the schedule of four slots that its sources have. Node 8 sends in slot 2. */
#include "gttcan.h"
#include "program.h"

static gttcan_t node;

static void transmit(uint32_t identifier, uint64_t data, void *context) { sent = identifier + (uint32_t)data + 1; }
static void set_timer(uint32_t time, void *context) { timer = time; }
static uint64_t read_value(uint16_t name, void *context) { return name; }
static void write_value(uint16_t name, uint64_t data, void *context) { written = name + (uint32_t)data + 1; }

static void receive(uint16_t slot, uint16_t name, uint64_t data)
{
    GTTCAN_process_frame(&node, slot * 1000u, ((uint32_t)slot << 14) | name, data);
}

void prepare(uint16_t windows, enum event event)
{
    GTTCAN_init(&node, 8, 1000, 4, transmit, set_timer, read_value, write_value, 0);
    for (int round = 0; round < 2; round++) {
        receive(0, NETWORK_TIME_SLOT, 0x8000000000001234u);
        receive(1, NODE10_NUM_RECEIVED_FRAMES, 1);
        if (round == 0 || event == REFERENCE) {
            GTTCAN_transmit_next_frame(&node);
            receive(3, NODE9_NUM_RECEIVED_FRAMES, 1);
        }
    }
    if (event == DATA) {
        GTTCAN_transmit_next_frame(&node);
    }
}

void handle(enum event event)
{
    switch (event) {
    case DATA: receive(3, NODE9_NUM_RECEIVED_FRAMES, 1); break;
    case REFERENCE: receive(0, NETWORK_TIME_SLOT, 0x8000000000001234u); break;
    case WINDOW: GTTCAN_transmit_next_frame(&node); break;
    }
}
