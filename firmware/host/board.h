/* The port of the host build: a board that exists in this process only. */
#ifndef BOARD_H
#define BOARD_H

#include "line.h"
#include "options.h"
#include "palpate_array.h"

struct board {
    struct options options;
    struct line line;
    struct palpate_array array;
    struct palpate_description description;
    float columns[255];
    float rows[255];
    uint64_t sampled;
    uint64_t device_us; /* if is_fast, or once all frames have been sampled */
    uint64_t start_us;
    uint32_t unrest; /* what unsteady taxels show */
    uint8_t kinds[PALPATE_MAX_TAXELS];
};

/* Make the board that the options describe. NULL, or what is wrong. The line must have been opened. */
const char *board_init(struct board *board, const struct options *options);

/* Whether all frames that were asked for have been sampled. */
bool board_is_done(const struct board *board);

/* The count of a good taxel in the frame with this number, before it is cut to the bit depth:
 *
 *     x = number * 0x9E3779B1 + taxel * 0x85EBCA77    (mod 2^32; taxel = row * columns + column)
 *     x = (x ^ (x >> 15)) * 0x2C1B3C6D                (mod 2^32)
 *     count = (x ^ (x >> 12)) mod 2^depth
 */
uint32_t board_pattern(uint32_t number, uint32_t taxel);

#endif
