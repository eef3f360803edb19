/* Answers to requests, from the array's state to bytes that wait for the line. */
#ifndef PALPATE_ANSWERS_H
#define PALPATE_ANSWERS_H

#include "palpate_array.h"

/* Whether a message with a payload of this length fits what waits for the line. */
bool palpate_fits(const struct palpate_array *array, size_t payload);

/* Begin any message: it gets the next number. */
void palpate_begin_message(struct palpate_array *array, struct palpate_writer *writer,
                           struct palpate_header header);

/* Payload of the longest answer that the waiting request may get. */
size_t palpate_answer_length(const struct palpate_array *array);

/* Taxels that TAXELS tells of, from `first` on. */
size_t palpate_places_told(const struct palpate_array *array, size_t first);

/* The answers to the waiting request; there must be room. `kinds` has a palpate_kind for each taxel. */
void palpate_send_ack(struct palpate_array *array);
void palpate_send_nack(struct palpate_array *array, enum palpate_reason reason);
void palpate_send_describe(struct palpate_array *array);
void palpate_send_places(struct palpate_array *array, size_t first);
void palpate_send_report(struct palpate_array *array, uint16_t result, const uint8_t *kinds);

size_t palpate_taxels(const struct palpate_array *array);
bool palpate_has_lines(const struct palpate_description *about);

#endif
