/* The matrix of taxels on an emulated board, in place of multiplexers and a converter: a memory that
 * whoever emulates the board writes, or a pattern. */
#ifndef MATRIX_H
#define MATRIX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MATRIX_ROWS 8u
#define MATRIX_COLUMNS 20u
#define MATRIX_DEPTH 12u
#define MATRIX_TAXELS (MATRIX_ROWS * MATRIX_COLUMNS)

enum matrix_source {
    MATRIX_PATTERN = 0, /* test/pattern.h: each frame can be checked by its number */
    MATRIX_QUIET = 1,   /* untouched skin: an offset, and a noise of a few counts */
    MATRIX_FED = 2      /* `counts`, written by another program while the board runs */
};

/* At a fixed address (MATRIX_AT): memory that starts as zeros. */
struct matrix {
    uint32_t source; /* matrix_source */
    uint32_t serial; /* of the board, where it has no number of its own */
    uint32_t turn;   /* odd while `counts` is being written */
    uint16_t counts[MATRIX_TAXELS];
};

/* Sample all taxels for the frame with this number. False if what is fed never stands still. */
bool matrix_sample(uint32_t number, uint16_t *counts, size_t count);

uint32_t matrix_serial(void);

#endif
