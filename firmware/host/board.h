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

#endif
