#include "palpate_receiver.h"

#include "palpate_wire.h"

const uint8_t *palpate_request_payload(const struct palpate_receiver *receiver) {
    return receiver->bytes + PALPATE_HEADER;
}

size_t palpate_request_length(const struct palpate_receiver *receiver) {
    return receiver->used - PALPATE_OVERHEAD;
}

void palpate_receiver_clear(struct palpate_receiver *receiver) {
    receiver->used = 0;
    receiver->is_oversized = false;
    receiver->is_waiting = false;
}

/* Whether the bytes since the last delimiter are a message that gets an answer; decodes them in place.
 */
static bool is_request(struct palpate_receiver *receiver) {
    const uint8_t *bytes = receiver->bytes;
    if (receiver->is_oversized ||
        !palpate_cobs_decode(receiver->bytes, receiver->used, &receiver->used) ||
        receiver->used < PALPATE_OVERHEAD) {
        return false;
    }
    const size_t checked = receiver->used - PALPATE_CRC;
    if (palpate_crc32(0, bytes, checked) != palpate_get_u32(bytes + checked)) {
        return false;
    }
    /* a version that is unknown is answered before its length is looked at */
    const size_t length = palpate_request_length(receiver);
    if (bytes[0] == PALPATE_VERSION && palpate_get_u16(bytes + 16) != length) {
        return false;
    }
    return (bytes[1] & 0x80u) == 0 && length >= 2;
}

static void keep(struct palpate_receiver *receiver, uint8_t byte) {
    if (receiver->used < sizeof receiver->bytes) {
        receiver->bytes[receiver->used++] = byte;
    } else {
        receiver->is_oversized = true;
    }
}

enum palpate_received palpate_receiver_feed(struct palpate_receiver *receiver, uint8_t byte) {
    if (byte != 0) {
        keep(receiver, byte);
        return PALPATE_NOTHING;
    }
    if (receiver->used == 0) {
        return PALPATE_NOTHING; /* nothing between two delimiters means nothing */
    }
    if (is_request(receiver)) {
        receiver->is_waiting = true;
        return PALPATE_REQUEST;
    }
    palpate_receiver_clear(receiver);
    return PALPATE_FAULT;
}
