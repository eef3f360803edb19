#include "board.h"

#include <math.h>
#include <string.h>
#include <time.h>

#include "test/pattern.h"

#define PITCH_MM 2.0f
#define RADIUS_MM 8.0f
#define SPREAD_RAD 4.712389f /* 270 degrees */
#define EXAMINED 32u

/* ---- what it is ---- */

static void set_lines(struct board *board) {
    struct palpate_description *about = &board->description;
    const bool is_round = about->shape == PALPATE_CYLINDER;
    const float pitch = is_round ? SPREAD_RAD / (float)about->columns : PITCH_MM;
    for (int i = 0; i < about->columns; i++) {
        board->columns[i] = pitch * ((float)i - 0.5f * (float)(about->columns - 1));
    }
    for (int i = 0; i < about->rows; i++) {
        board->rows[i] = PITCH_MM * ((float)i + 0.5f);
    }
    about->column_places = board->columns;
    about->row_heights = board->rows;
    about->tip_radius_mm = is_round ? RADIUS_MM : 0.0f;
}

static const char *set_kinds(struct board *board) {
    for (unsigned i = 0; i < board->options.stuck_count; i++) {
        const struct stuck *stuck = &board->options.stuck[i];
        if (stuck->row >= board->description.rows || stuck->column >= board->description.columns) {
            return "a stuck taxel lies outside of the array";
        }
        board->kinds[stuck->row * board->description.columns + stuck->column] = (uint8_t)stuck->kind;
    }
    return NULL;
}

static uint64_t monotonic_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

const char *board_init(struct board *board, const struct options *options) {
    const float largest = (float)((1u << options->depth) - 1u);
    board->options = *options;
    board->description = (struct palpate_description){
        .is_emulated = true,
        .shape = options->shape,
        .bit_depth = options->depth,
        .rows = options->rows,
        .columns = options->columns,
        .max_rate_mhz = options->max_rate_mhz,
        .full_scale_n = 2.0f,
        .counts_per_n = largest / 2.0f,
        .firmware = "palpate-array-host 1",
        .has_self_test = !options->is_plain,
        .has_geometry = !options->is_plain,
    };
    memcpy(board->description.unique_id, "pty-host", 8);
    memcpy(board->description.unique_id + 8, &options->seed, 8);
    set_lines(board);
    board->unrest = 1;
    board->start_us = monotonic_us();
    const char *wrong = palpate_init(&board->array, &board->description, board);
    return wrong != NULL ? wrong : set_kinds(board);
}

bool board_is_done(const struct board *board) {
    return board->options.frames != 0 && board->sampled >= board->options.frames;
}

/* ---- what it feels ---- */

static uint16_t count(struct board *board, uint32_t number, uint32_t taxel) {
    const uint32_t largest = board->array.largest;
    switch (board->kinds[taxel]) {
    case PALPATE_STUCK_LOW: return 0;
    case PALPATE_STUCK_HIGH: return (uint16_t)largest;
    case PALPATE_UNSTEADY:
        board->unrest = frame_pattern(board->unrest, taxel) + 1u;
        return (uint16_t)(board->unrest & largest);
    default: return (uint16_t)(frame_pattern(number, taxel) & largest);
    }
}

/* What is wrong with a taxel, judged by its counts alone: the same number is sampled twice. */
static enum palpate_kind examine(struct board *board, uint32_t taxel) {
    bool is_low = true;
    bool is_high = true;
    bool is_unsteady = false;
    for (uint32_t number = 0; number < EXAMINED; number++) {
        const uint16_t once = count(board, number, taxel);
        const uint16_t twice = count(board, number, taxel);
        is_low = is_low && once == 0;
        is_high = is_high && once == board->array.largest;
        is_unsteady = is_unsteady || once != twice;
    }
    return is_low        ? PALPATE_STUCK_LOW
           : is_high     ? PALPATE_STUCK_HIGH
           : is_unsteady ? PALPATE_UNSTEADY
                         : PALPATE_GOOD;
}

/* ---- palpate_port.h ---- */

bool palpate_port_read(void *port, uint8_t *byte) {
    struct board *board = port;
    return line_get(&board->line, byte);
}

size_t palpate_port_write(void *port, const uint8_t *bytes, size_t bytes_count) {
    struct board *board = port;
    return line_put(&board->line, bytes, bytes_count);
}

uint64_t palpate_port_clock_us(void *port) {
    const struct board *board = port;
    if (board->options.is_fast || board_is_done(board)) {
        return board->device_us;
    }
    return monotonic_us() - board->start_us;
}

bool palpate_port_stream(void *port, bool on) {
    const struct board *board = port;
    return !on || !board->options.is_broken;
}

/* Samples show the number that their frame will have, so that a host can check each frame by itself. */
bool palpate_port_sample(void *port, uint16_t *counts, size_t taxels) {
    struct board *board = port;
    for (size_t i = 0; i < taxels; i++) {
        counts[i] = count(board, board->array.sequence, (uint32_t)i);
    }
    if (!board->options.is_fast) {
        board->device_us = palpate_port_clock_us(port);
    }
    board->sampled++;
    return true;
}

bool palpate_port_self_test(void *port, uint16_t *result, uint8_t *kinds, size_t taxels) {
    struct board *board = port;
    *result = 0;
    for (size_t i = 0; i < taxels; i++) {
        kinds[i] = (uint8_t)examine(board, (uint32_t)i);
    }
    return !board->options.is_broken;
}

/* Free arrays are half a sphere: rows are circles of latitude, the lowest one at its equator. */
void palpate_port_place(void *port, size_t number, float place[6]) {
    const struct board *board = port;
    const struct palpate_description *about = &board->description;
    const size_t row = number / about->columns;
    const size_t column = number % about->columns;
    const bool is_flat = about->shape == PALPATE_FLAT;
    const bool is_free = about->shape == PALPATE_FREE;
    const float turn =
        is_free ? 6.2831853f * (float)column / (float)about->columns : board->columns[column];
    const float rise = is_free ? 1.5707963f * (float)row / (float)about->rows : 0.0f;
    place[3] = is_flat ? 0.0f : cosf(turn) * cosf(rise);
    place[4] = is_flat ? -1.0f : sinf(turn) * cosf(rise);
    place[5] = is_free ? sinf(rise) : 0.0f;
    place[0] = is_flat ? board->columns[column] : RADIUS_MM * place[3];
    place[1] = is_flat ? 0.0f : RADIUS_MM * place[4];
    place[2] = is_free ? RADIUS_MM * (1.0f + place[5]) : board->rows[row];
}
