/* Bytes from the host, up to a request whose framing, CRC and length are right. What it asks is not
 * looked at. */
#ifndef PALPATE_RECEIVER_H
#define PALPATE_RECEIVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "palpate_sizes.h"

struct palpate_receiver {
    uint8_t bytes[PALPATE_RX_BYTES]; /* since the last delimiter; or a request: header, payload, CRC */
    size_t used;
    bool is_oversized; /* nothing is kept until the next delimiter */
    bool is_waiting;   /* `bytes` is a request that has not been answered */
};

enum palpate_received { PALPATE_NOTHING, PALPATE_REQUEST, PALPATE_FAULT };

/* Take a byte. Not while a request waits. A fault is a message that gets no answer. */
enum palpate_received palpate_receiver_feed(struct palpate_receiver *receiver, uint8_t byte);

/* The request has been answered: listen on. */
void palpate_receiver_clear(struct palpate_receiver *receiver);

/* Parts of the request that waits. The payload has at least two bytes, the request's number. */
const uint8_t *palpate_request_payload(const struct palpate_receiver *receiver);
size_t palpate_request_length(const struct palpate_receiver *receiver);

#endif
