/* When frames are due. Knows no clock: instants are given in and come out. */
#ifndef PALPATE_PACE_H
#define PALPATE_PACE_H

#include <stdbool.h>
#include <stdint.h>

/* The instants are exact: a rate whose period is no whole number of microseconds does not drift. */
struct palpate_pace {
    bool is_streaming;
    uint32_t rate_mhz; /* thousandths of a frame per second */
    uint64_t last_us;  /* when the last frame was due; START before the first */
    uint64_t next_us;
    uint32_t part; /* of next_us, in 1/rate_mhz µs */
};

/* Begin a stream: the first frame is due one period after `now_us`. */
void palpate_pace_start(struct palpate_pace *pace, uint32_t rate_mhz, uint64_t now_us);

/* Another rate: the next frame is due one new period after the last one, or now if that is over. */
void palpate_pace_change(struct palpate_pace *pace, uint32_t rate_mhz, uint64_t now_us);

/* The frame that was due is done with. */
void palpate_pace_step(struct palpate_pace *pace);

#endif
