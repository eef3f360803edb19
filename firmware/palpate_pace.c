#include "palpate_pace.h"

/* µs times thousandths of a frame per second: what a period and a rate multiply to. */
#define ONE_FRAME 1000000000u

void palpate_pace_step(struct palpate_pace *pace) {
    pace->last_us = pace->next_us;
    pace->next_us += ONE_FRAME / pace->rate_mhz;
    pace->part += ONE_FRAME % pace->rate_mhz;
    if (pace->part >= pace->rate_mhz) {
        pace->part -= pace->rate_mhz;
        pace->next_us++;
    }
}

static void restart(struct palpate_pace *pace, uint32_t rate_mhz, uint64_t from_us) {
    pace->rate_mhz = rate_mhz;
    pace->next_us = from_us;
    pace->part = 0;
    palpate_pace_step(pace);
}

void palpate_pace_start(struct palpate_pace *pace, uint32_t rate_mhz, uint64_t now_us) {
    restart(pace, rate_mhz, now_us);
    pace->is_streaming = true;
}

void palpate_pace_change(struct palpate_pace *pace, uint32_t rate_mhz, uint64_t now_us) {
    restart(pace, rate_mhz, pace->last_us);
    if (pace->next_us < now_us) {
        pace->next_us = now_us; /* frames that nobody had asked for yet are not missing */
        pace->part = 0;
    }
}
