/* The device side of docs/tactile-protocol.md: a tactile array that describes itself and streams frames.
 *
 * Fill in palpate_port.h, then
 *
 *     static struct palpate_array array;
 *     palpate_init(&array, &description, NULL);
 *     for (;;) palpate_poll(&array);
 *
 * All state is in the struct. Nothing is allocated, nothing waits, and nothing is called back but the
 * port. */
#ifndef PALPATE_ARRAY_H
#define PALPATE_ARRAY_H

#include "palpate_pace.h"
#include "palpate_port.h"
#include "palpate_receiver.h"
#include "palpate_sizes.h"
#include "palpate_tare.h"
#include "palpate_wire.h"

enum palpate_type {
    PALPATE_HELLO = 0x01,
    PALPATE_START = 0x02,
    PALPATE_STOP = 0x03,
    PALPATE_RATE = 0x04,
    PALPATE_TARE = 0x05,
    PALPATE_SELF_TEST = 0x06,
    PALPATE_GEOMETRY = 0x07,
    PALPATE_DESCRIBE = 0x81,
    PALPATE_ACK = 0x82,
    PALPATE_NACK = 0x83,
    PALPATE_REPORT = 0x84,
    PALPATE_PLACES = 0x85, /* TAXELS on the page */
    PALPATE_FRAME = 0x90
};

enum palpate_reason {
    PALPATE_NO_REASON = 0,
    PALPATE_UNKNOWN_TYPE = 1,
    PALPATE_BAD_PAYLOAD = 2,
    PALPATE_BAD_RATE = 3,
    PALPATE_HARDWARE = 4,
    PALPATE_BAD_STATE = 5,
    PALPATE_BAD_VERSION = 6
};

#define PALPATE_FLAG_TARED 0x0001u

/* How it went since the start; for a debugger, a display, or a test. */
struct palpate_counters {
    uint32_t faults;   /* of what came in: framing, short, oversized, CRC, length, nothing to answer */
    uint32_t requests; /* that were answered */
    uint32_t frames;   /* that went into the buffer */
    uint32_t given_up; /* frames that were numbered and not sent: line full, sampling failed or late */
};

struct palpate_array {
    const struct palpate_description *about;
    void *port;
    uint32_t sequence; /* number of the next message */
    uint16_t largest;  /* count */
    struct palpate_receiver receiver;
    struct palpate_pace pace;
    struct palpate_tare tare;
    struct palpate_counters counters;
    uint16_t counts[PALPATE_MAX_TAXELS];
    struct palpate_ring ring;
};

/* Begin, as after a reset. Returns NULL, or what is wrong with the description; do not poll then. */
const char *palpate_init(struct palpate_array *array, const struct palpate_description *about,
                         void *port);

/* Do what there is to do: read, answer, sample if it is time, write. Call it as often as possible, at
 * least twice in a frame's period. Does not wait, except for palpate_port_self_test. */
void palpate_poll(struct palpate_array *array);

/* When the next frame is due, on the port's clock; false if no stream runs. For boards that sleep
 * meanwhile: they must also wake when a byte comes or the line has room again. */
bool palpate_next_us(const struct palpate_array *array, uint64_t *next_us);

#endif
