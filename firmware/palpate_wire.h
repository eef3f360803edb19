/* Bytes of docs/tactile-protocol.md: COBS, CRC-32, header. Stands between the array's state and the
 * port.
 *
 * Messages are encoded straight into a ring of bytes that wait for the line, so that no plain copy of a
 * frame is kept. */
#ifndef PALPATE_WIRE_H
#define PALPATE_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "palpate_sizes.h"

#define PALPATE_VERSION 1

/* Bytes that wait for the line; `first` is the oldest. */
struct palpate_ring {
    uint8_t bytes[PALPATE_TX_BYTES];
    size_t first;
    size_t used;
};

/* A message while it is being written. */
struct palpate_writer {
    struct palpate_ring *ring;
    size_t code_at; /* place in the ring of the length of the COBS block that is open */
    uint8_t code;   /* that length so far */
    uint32_t crc;
};

struct palpate_header {
    uint8_t version;
    uint8_t type;
    uint16_t flags;
    uint32_t sequence;
    uint64_t time_us;
    uint16_t length; /* bytes of payload */
};

/* CRC-32 of more bytes: begin with 0 as zlib does. */
uint32_t palpate_crc32(uint32_t crc, const uint8_t *bytes, size_t count);

/* Decode COBS in place, without the delimiter. False if it is not COBS; then the bytes are spoilt. */
bool palpate_cobs_decode(uint8_t *bytes, size_t count, size_t *plain);

/* Whether `encoded` more bytes fit. Ask before a message is begun: nothing checks it later. */
bool palpate_ring_fits(const struct palpate_ring *ring, size_t encoded);

/* Begin a message, append to its payload, close it. The payload must have header->length bytes. */
void palpate_begin(struct palpate_writer *writer, struct palpate_ring *ring,
                   const struct palpate_header *header);
void palpate_put(struct palpate_writer *writer, const uint8_t *bytes, size_t count);
void palpate_put_u8(struct palpate_writer *writer, uint8_t value);
void palpate_put_u16(struct palpate_writer *writer, uint16_t value);
void palpate_put_u32(struct palpate_writer *writer, uint32_t value);
void palpate_put_real(struct palpate_writer *writer, float value);
void palpate_end(struct palpate_writer *writer);

uint16_t palpate_get_u16(const uint8_t *bytes);
uint32_t palpate_get_u32(const uint8_t *bytes);

#endif
