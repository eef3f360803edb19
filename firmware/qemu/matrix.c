#include "matrix.h"

#include "test/pattern.h"

#define LARGEST ((1u << MATRIX_DEPTH) - 1u)
#define OFFSET 200u
#define PATIENCE 1000u

#define MATRIX ((const volatile struct matrix *)MATRIX_AT)

uint32_t matrix_serial(void) {
    return MATRIX->serial;
}

/* A copy is whole if nobody began to write before it was made. */
static bool fed(uint16_t *counts, size_t count) {
    for (unsigned i = 0; i < PATIENCE; i++) {
        const uint32_t before = MATRIX->turn;
        for (size_t k = 0; k < count; k++) {
            counts[k] = MATRIX->counts[k];
        }
        if (before % 2u == 0 && MATRIX->turn == before) {
            return true;
        }
    }
    return false;
}

bool matrix_sample(uint32_t number, uint16_t *counts, size_t count) {
    const uint32_t source = MATRIX->source;
    if (source == MATRIX_FED) {
        return fed(counts, count);
    }
    for (size_t i = 0; i < count; i++) {
        const uint32_t drawn = frame_pattern(number, (uint32_t)i);
        const uint32_t quiet = OFFSET + (drawn & 3u) + (drawn >> 2 & 3u); /* 0 to 6 more, by a triangle */
        counts[i] = (uint16_t)(source == MATRIX_QUIET ? quiet : drawn & LARGEST);
    }
    return true;
}
