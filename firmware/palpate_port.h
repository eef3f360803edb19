/* What the firmware needs of a board: seven short functions and a description. Fill them in, beginning
 * with a copy of port_template.c. Nothing else knows the hardware.
 *
 * `port` is the pointer that was given to palpate_init, for a board with several arrays; ignore it
 * otherwise. All are called from palpate_poll only, never from an interrupt, and none may wait unless it
 * says so. */
#ifndef PALPATE_PORT_H
#define PALPATE_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum palpate_shape { PALPATE_FLAT = 0, PALPATE_CYLINDER = 1, PALPATE_FREE = 2 };

/* What the array is: constant, and kept by the caller as long as the array is used. */
struct palpate_description {
    uint8_t unique_id[16];    /* never the same for two arrays: the chip's serial number, say */
    bool is_emulated;         /* false on real hardware */
    enum palpate_shape shape; /* the tip frame is explained in docs/tactile-protocol.md */
    uint8_t bit_depth;        /* 1..16; palpate_port_sample gives counts up to 2^bit_depth - 1 */
    uint8_t rows;             /* lowest row first */
    uint8_t columns;
    uint32_t max_rate_mhz;      /* thousandths of a frame per second, up to 10^9 */
    float full_scale_n;         /* N on one taxel that bring it to the largest count */
    float counts_per_n;         /* nominal, of one taxel */
    float tip_radius_mm;        /* cylinder only; 0 otherwise */
    const float *column_places; /* `columns` of them, ascending, mm if flat, else rad; NULL if free */
    const float *row_heights;   /* `rows` of them, ascending, mm; NULL if free */
    const char *firmware;       /* name and version, UTF-8 */
    bool has_self_test;         /* false: SELF_TEST is answered with UNKNOWN_TYPE */
    bool has_geometry;          /* palpate_port_place works; must be true if free */
};

/* What is wrong with a taxel. */
enum palpate_kind {
    PALPATE_GOOD = 0,
    PALPATE_STUCK_LOW = 1,
    PALPATE_STUCK_HIGH = 2,
    PALPATE_UNSTEADY = 3
};

/* Bits of a self-test's result; bit 4 (taxels) is set by the caller. Bits 5..15 are the maker's. */
#define PALPATE_PROGRAM_MEMORY 0x01u
#define PALPATE_WORKING_MEMORY 0x02u
#define PALPATE_CONVERTER 0x04u
#define PALPATE_SUPPLY 0x08u
#define PALPATE_TAXELS 0x10u

/* Take the next byte from the host, if there is one. A UART needs an interrupt or DMA that stores at
 * least 128 bytes, because palpate_poll leaves them there while it samples or while an answer waits for
 * the line. */
bool palpate_port_read(void *port, uint8_t *byte);

/* Give up to `count` bytes to the line without waiting, and say how many it took: 0 if it is full. */
size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count);

/* Microseconds since the start. Must not run backwards or wrap: extend a 32-bit timer in software. */
uint64_t palpate_port_clock_us(void *port);

/* Get ready to sample (`on`), or rest. False if something is broken: START is then refused with
 * HARDWARE, and a stream that runs already goes on. May be called twice with the same value. */
bool palpate_port_stream(void *port, bool on);

/* Sample all taxels, `count` = rows x columns of them, lowest row first. Should take much less than a
 * period: if the converter is slow, let DMA fill a buffer and copy it here. False if it failed: the
 * frame is then left out. */
bool palpate_port_sample(void *port, uint16_t *counts, size_t count);

/* Examine the array, which is not streaming; may take 1.5 s. Set bits in `result`, and `kinds[i]`
 * (palpate_kind, all PALPATE_GOOD before) of taxels that are bad. False if it cannot be done: answered
 * with HARDWARE. Called only if has_self_test. */
bool palpate_port_self_test(void *port, uint16_t *result, uint8_t *kinds, size_t count);

/* Where taxel `number` (row x columns + column) is: x, y, z in mm and its outward unit normal, in the
 * tip frame. Called only if has_geometry. */
void palpate_port_place(void *port, size_t number, float place[6]);

#endif
