#include "palpate_tare.h"

#include <string.h>

void palpate_tare_clear(struct palpate_tare *tare) {
    tare->is_tared = false;
    tare->left = 0;
}

void palpate_tare_begin(struct palpate_tare *tare, uint16_t samples, uint16_t pedestal) {
    memset(tare->sum, 0, sizeof tare->sum);
    tare->samples = samples;
    tare->left = samples;
    tare->new_pedestal = pedestal;
}

/* The mean rounded to the nearest, halves up. */
static uint16_t mean(uint32_t sum, uint32_t samples) {
    return (uint16_t)((2u * sum + samples) / (2u * samples));
}

void palpate_tare_add(struct palpate_tare *tare, const uint16_t *counts, size_t taxels) {
    if (tare->left == 0) {
        return;
    }
    for (size_t i = 0; i < taxels; i++) {
        tare->sum[i] += counts[i];
    }
    tare->left--;
    if (tare->left > 0) {
        return;
    }
    for (size_t i = 0; i < taxels; i++) {
        tare->zero[i] = mean(tare->sum[i], tare->samples);
    }
    tare->pedestal = tare->new_pedestal;
    tare->is_tared = true;
}

uint16_t palpate_tare_count(const struct palpate_tare *tare, size_t taxel, uint16_t raw,
                            uint16_t largest) {
    if (!tare->is_tared) {
        return raw;
    }
    if (raw >= largest) {
        return largest; /* saturated stays saturated */
    }
    const int32_t count = (int32_t)raw - (int32_t)tare->zero[taxel] + (int32_t)tare->pedestal;
    if (count < 0) {
        return 0;
    }
    return count > (int32_t)largest ? largest : (uint16_t)count;
}
