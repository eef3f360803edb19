/* Bytes between an interrupt and palpate_poll: a ring with one writer and one reader, on one core.
 *
 * Each index has one writer only, so neither side has to lock the other out. Indices run on and are cut
 * to the ring's size when bytes are touched; full and empty differ by that. 8 bit each: every processor
 * reads them in one piece. On two cores a memory barrier belongs before each index is moved. */
#ifndef BYTE_RING_H
#define BYTE_RING_H

#include <stdbool.h>
#include <stdint.h>

#define BYTE_RING_SIZE 128u /* a power of two, 128 at most */

struct byte_ring {
    volatile uint8_t bytes[BYTE_RING_SIZE];
    volatile uint8_t written; /* moved by the writer */
    volatile uint8_t taken;   /* moved by the reader */
};

static inline bool byte_ring_is_full(const struct byte_ring *ring) {
    return (uint8_t)(ring->written - ring->taken) == BYTE_RING_SIZE;
}

/* Append a byte; false if the ring is full. The writer's. */
static inline bool byte_ring_put(struct byte_ring *ring, uint8_t byte) {
    const uint8_t written = ring->written;
    if (byte_ring_is_full(ring)) {
        return false;
    }
    ring->bytes[written % BYTE_RING_SIZE] = byte;
    ring->written = (uint8_t)(written + 1u);
    return true;
}

/* Take the oldest byte; false if there is none. The reader's. */
static inline bool byte_ring_take(struct byte_ring *ring, uint8_t *byte) {
    const uint8_t taken = ring->taken;
    if (taken == ring->written) {
        return false;
    }
    *byte = ring->bytes[taken % BYTE_RING_SIZE];
    ring->taken = (uint8_t)(taken + 1u);
    return true;
}

static inline bool byte_ring_is_empty(const struct byte_ring *ring) {
    return ring->taken == ring->written;
}

#endif
