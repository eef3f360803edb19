#include "palpate_wire.h"

#include <string.h>

/* CRC-32 of the sixteen half bytes: 64 bytes of flash instead of 1024, two steps for each byte. */
static const uint32_t crc_of_nibble[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
    0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
    0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

uint32_t palpate_crc32(uint32_t crc, const uint8_t *bytes, size_t count) {
    crc = ~crc;
    for (size_t i = 0; i < count; i++) {
        crc ^= bytes[i];
        crc = (crc >> 4) ^ crc_of_nibble[crc & 15u];
        crc = (crc >> 4) ^ crc_of_nibble[crc & 15u];
    }
    return ~crc;
}

bool palpate_cobs_decode(uint8_t *bytes, size_t count, size_t *plain) {
    size_t from = 0;
    size_t to = 0;
    while (from < count) {
        const uint8_t code = bytes[from++];
        const size_t block = (size_t)code - 1u;
        if (code == 0 || block > count - from) {
            return false;
        }
        for (size_t i = 0; i < block; i++) {
            if (bytes[from] == 0) {
                return false;
            }
            bytes[to++] = bytes[from++];
        }
        if (code != 0xFF && from < count) {
            bytes[to++] = 0;
        }
    }
    *plain = to;
    return count > 0;
}

bool palpate_ring_fits(const struct palpate_ring *ring, size_t encoded) {
    return encoded <= sizeof ring->bytes - ring->used;
}

static size_t append(struct palpate_ring *ring, uint8_t byte) {
    size_t at = ring->first + ring->used;
    if (at >= sizeof ring->bytes) {
        at -= sizeof ring->bytes;
    }
    ring->bytes[at] = byte;
    ring->used++;
    return at;
}

static void open_block(struct palpate_writer *writer) {
    writer->code_at = append(writer->ring, 0);
    writer->code = 1;
}

static void close_block(struct palpate_writer *writer) {
    writer->ring->bytes[writer->code_at] = writer->code;
}

/* A byte without its share in the CRC. A block is closed late, so that one of 254 bytes at the very end
 * of a message is not followed by an empty one. */
static void stuff(struct palpate_writer *writer, uint8_t byte) {
    if (writer->code == 0xFF) {
        close_block(writer);
        open_block(writer);
    }
    if (byte == 0) {
        close_block(writer);
        open_block(writer);
    } else {
        (void)append(writer->ring, byte);
        writer->code++;
    }
}

void palpate_put(struct palpate_writer *writer, const uint8_t *bytes, size_t count) {
    writer->crc = palpate_crc32(writer->crc, bytes, count);
    for (size_t i = 0; i < count; i++) {
        stuff(writer, bytes[i]);
    }
}

void palpate_put_u8(struct palpate_writer *writer, uint8_t value) {
    palpate_put(writer, &value, 1);
}

void palpate_put_u16(struct palpate_writer *writer, uint16_t value) {
    const uint8_t bytes[2] = {(uint8_t)(value & 0xFFu), (uint8_t)(value >> 8)};
    palpate_put(writer, bytes, sizeof bytes);
}

void palpate_put_u32(struct palpate_writer *writer, uint32_t value) {
    palpate_put_u16(writer, (uint16_t)(value & 0xFFFFu));
    palpate_put_u16(writer, (uint16_t)(value >> 16));
}

void palpate_put_real(struct palpate_writer *writer, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    palpate_put_u32(writer, bits);
}

void palpate_begin(struct palpate_writer *writer, struct palpate_ring *ring,
                   const struct palpate_header *header) {
    writer->ring = ring;
    writer->crc = 0;
    open_block(writer);
    palpate_put_u8(writer, header->version);
    palpate_put_u8(writer, header->type);
    palpate_put_u16(writer, header->flags);
    palpate_put_u32(writer, header->sequence);
    palpate_put_u32(writer, (uint32_t)(header->time_us & 0xFFFFFFFFu));
    palpate_put_u32(writer, (uint32_t)(header->time_us >> 32));
    palpate_put_u16(writer, header->length);
}

void palpate_end(struct palpate_writer *writer) {
    const uint32_t crc = writer->crc;
    palpate_put_u32(writer, crc);
    close_block(writer);
    (void)append(writer->ring, 0);
}

uint16_t palpate_get_u16(const uint8_t *bytes) {
    return (uint16_t)((unsigned)bytes[0] | ((unsigned)bytes[1] << 8));
}

uint32_t palpate_get_u32(const uint8_t *bytes) {
    return (uint32_t)palpate_get_u16(bytes) | ((uint32_t)palpate_get_u16(bytes + 2) << 16);
}
