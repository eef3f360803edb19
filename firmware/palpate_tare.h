/* TARE: the zero of each taxel, averaged over samples and taken off the counts. */
#ifndef PALPATE_TARE_H
#define PALPATE_TARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "palpate_sizes.h"

#define PALPATE_MAX_SAMPLES 1024u

struct palpate_tare {
    uint16_t zero[PALPATE_MAX_TAXELS]; /* in use if is_tared */
    uint16_t pedestal;
    bool is_tared;
    uint32_t sum[PALPATE_MAX_TAXELS]; /* of the samples taken so far, if `left` > 0 */
    uint16_t samples;                 /* that are being averaged */
    uint16_t left;                    /* of them */
    uint16_t new_pedestal;            /* for when they are there */
};

/* Raw counts from now on, and no averaging. */
void palpate_tare_clear(struct palpate_tare *tare);

/* Average `samples` samples (1..PALPATE_MAX_SAMPLES). Until they are there, counts are what they were
 * before. */
void palpate_tare_begin(struct palpate_tare *tare, uint16_t samples, uint16_t pedestal);

/* Take a sample into the average, if one is being made. To be called once its own frame has been sent.
 */
void palpate_tare_add(struct palpate_tare *tare, const uint16_t *counts, size_t taxels);

/* What is sent for a raw count; `largest` is the largest count. */
uint16_t palpate_tare_count(const struct palpate_tare *tare, size_t taxel, uint16_t raw,
                            uint16_t largest);

#endif
