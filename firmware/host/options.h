/* What palpate-array-host is told on its command line. */
#ifndef OPTIONS_H
#define OPTIONS_H

#include <stdbool.h>
#include <stdint.h>

#include "palpate_port.h"

#define MAX_STUCK 300

struct stuck {
    uint8_t row;
    uint8_t column;
    enum palpate_kind kind;
};

struct options {
    uint8_t rows;
    uint8_t columns;
    enum palpate_shape shape;
    uint8_t depth;
    uint32_t max_rate_mhz;
    uint64_t frames; /* to be sampled at most, all in all; 0: no limit */
    double flip;     /* share of the bytes to the host that get one bit flipped */
    double flip_in;  /* the same of those from the host */
    uint64_t seed;
    bool is_fast;
    bool is_plain;  /* knows neither SELF_TEST nor GEOMETRY */
    bool is_broken; /* START and SELF_TEST are refused with HARDWARE */
    struct stuck stuck[MAX_STUCK];
    unsigned stuck_count;
};

/* Read the command line. On a mistake says so on stderr and exits with 2; --help exits with 0. */
struct options options_read(int argc, char **argv);

#endif
