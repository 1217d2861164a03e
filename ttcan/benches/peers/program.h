#include <stdbool.h>
#include <stdint.h>

enum event { DATA, REFERENCE, WINDOW };

extern volatile uint32_t timer, sent, written;

/* Makes a node that is in schedule and before the event. Each peer has its own. */
void prepare(uint16_t windows, enum event event);
/* The event. Each peer has its own. */
void handle(enum event event);
