/* The firmware on a bench: a port whose line, clock and taxels are in the hands of a test. Made to be
 * loaded as a shared library; tests/support/devices/firmware.py wraps it. */
#include <stddef.h>
#include <string.h>

#include "palpate_array.h"

struct bench {
    struct palpate_array array;
    struct palpate_description description;
    float column_places[255];
    float row_heights[255];
    char firmware[PALPATE_MAX_NAME + 2];
    uint8_t in[8192];
    size_t in_first;
    size_t in_used;
    uint8_t out[65536];
    size_t out_used;
    size_t room; /* bytes that the line still takes */
    uint64_t clock_us;
    uint16_t counts[PALPATE_MAX_TAXELS];
    uint8_t kinds[PALPATE_MAX_TAXELS];
    float places[PALPATE_MAX_TAXELS][6];
    uint16_t result;
    bool can_stream;
    bool can_sample;
    bool can_test;
    bool is_on;
};

/* ---- what a test does ---- */

size_t bench_size(void);
const char *bench_init(struct bench *bench, const struct palpate_description *description);
size_t bench_input(struct bench *bench, const uint8_t *bytes, size_t count);
void bench_poll(struct bench *bench, uint64_t clock_us);
size_t bench_output(struct bench *bench, uint8_t *bytes, size_t room);
void bench_set_room(struct bench *bench, size_t room);
void bench_set_sequence(struct bench *bench, uint32_t sequence);
void bench_set_counts(struct bench *bench, const uint16_t *counts, size_t count);
void bench_set_kinds(struct bench *bench, const uint8_t *kinds, size_t count, uint16_t result);
void bench_set_places(struct bench *bench, const float *places, size_t count);
void bench_set_health(struct bench *bench, bool can_stream, bool can_sample, bool can_test);
bool bench_is_on(const struct bench *bench);
void bench_counters(const struct bench *bench, uint32_t counters[4]);

size_t bench_size(void) {
    return sizeof(struct bench);
}

/* Copies what the description points to. */
const char *bench_init(struct bench *bench, const struct palpate_description *description) {
    memset(bench, 0, sizeof *bench);
    bench->description = *description;
    if (description->column_places != NULL) {
        memcpy(bench->column_places, description->column_places, description->columns * sizeof(float));
        bench->description.column_places = bench->column_places;
    }
    if (description->row_heights != NULL) {
        memcpy(bench->row_heights, description->row_heights, description->rows * sizeof(float));
        bench->description.row_heights = bench->row_heights;
    }
    strncpy(bench->firmware, description->firmware, sizeof bench->firmware - 1);
    bench->description.firmware = bench->firmware;
    bench->room = SIZE_MAX;
    bench->can_stream = bench->can_sample = bench->can_test = true;
    return palpate_init(&bench->array, &bench->description, bench);
}

/* Bytes that the host sends; says how many there was room for. */
size_t bench_input(struct bench *bench, const uint8_t *bytes, size_t count) {
    memmove(bench->in, bench->in + bench->in_first, bench->in_used - bench->in_first);
    bench->in_used -= bench->in_first;
    bench->in_first = 0;
    const size_t left = sizeof bench->in - bench->in_used;
    const size_t taken = count < left ? count : left;
    memcpy(bench->in + bench->in_used, bytes, taken);
    bench->in_used += taken;
    return taken;
}

void bench_poll(struct bench *bench, uint64_t clock_us) {
    bench->clock_us = clock_us;
    palpate_poll(&bench->array);
}

/* Take what the array has sent. */
size_t bench_output(struct bench *bench, uint8_t *bytes, size_t room) {
    const size_t taken = bench->out_used < room ? bench->out_used : room;
    memcpy(bytes, bench->out, taken);
    memmove(bench->out, bench->out + taken, bench->out_used - taken);
    bench->out_used -= taken;
    return taken;
}

void bench_set_room(struct bench *bench, size_t room) {
    bench->room = room;
}

void bench_set_sequence(struct bench *bench, uint32_t sequence) {
    bench->array.sequence = sequence;
}

void bench_set_counts(struct bench *bench, const uint16_t *counts, size_t count) {
    memcpy(bench->counts, counts, count * sizeof *counts);
}

void bench_set_kinds(struct bench *bench, const uint8_t *kinds, size_t count, uint16_t result) {
    memcpy(bench->kinds, kinds, count);
    bench->result = result;
}

void bench_set_places(struct bench *bench, const float *places, size_t count) {
    memcpy(bench->places, places, count * sizeof bench->places[0]);
}

void bench_set_health(struct bench *bench, bool can_stream, bool can_sample, bool can_test) {
    bench->can_stream = can_stream;
    bench->can_sample = can_sample;
    bench->can_test = can_test;
}

bool bench_is_on(const struct bench *bench) {
    return bench->is_on;
}

void bench_counters(const struct bench *bench, uint32_t counters[4]) {
    counters[0] = bench->array.counters.faults;
    counters[1] = bench->array.counters.requests;
    counters[2] = bench->array.counters.frames;
    counters[3] = bench->array.counters.given_up;
}

/* ---- palpate_port.h ---- */

bool palpate_port_read(void *port, uint8_t *byte) {
    struct bench *bench = port;
    if (bench->in_first == bench->in_used) {
        return false;
    }
    *byte = bench->in[bench->in_first++];
    return true;
}

size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count) {
    struct bench *bench = port;
    const size_t left = sizeof bench->out - bench->out_used;
    const size_t room = bench->room < left ? bench->room : left;
    const size_t taken = count < room ? count : room;
    memcpy(bench->out + bench->out_used, bytes, taken);
    bench->out_used += taken;
    bench->room -= taken;
    return taken;
}

uint64_t palpate_port_clock_us(void *port) {
    const struct bench *bench = port;
    return bench->clock_us;
}

bool palpate_port_stream(void *port, bool on) {
    struct bench *bench = port;
    bench->is_on = on && bench->can_stream;
    return !on || bench->can_stream;
}

bool palpate_port_sample(void *port, uint16_t *counts, size_t count) {
    const struct bench *bench = port;
    memcpy(counts, bench->counts, count * sizeof *counts);
    return bench->can_sample;
}

bool palpate_port_self_test(void *port, uint16_t *result, uint8_t *kinds, size_t count) {
    const struct bench *bench = port;
    *result = bench->result;
    memcpy(kinds, bench->kinds, count);
    return bench->can_test;
}

void palpate_port_place(void *port, size_t number, float place[6]) {
    const struct bench *bench = port;
    memcpy(place, bench->places[number], sizeof bench->places[number]);
}
