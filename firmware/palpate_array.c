/* Requests, answers and the pace of frames. The page's section 3 is `answer` and `refusal` here. */
#include "palpate_array.h"

#include <string.h>

#include "palpate_answers.h"

/* Bytes that one poll reads at most, so that a host that never stops talking cannot keep the array from
 * sampling. */
#define READ_AT_ONCE 64

/* ---- setting up ---- */

static const char *problem(const struct palpate_description *about) {
    if (about->rows == 0 || about->columns == 0) {
        return "rows and columns must be 1 to 255";
    }
    if ((size_t)about->rows * about->columns > PALPATE_MAX_TAXELS) {
        return "more taxels than PALPATE_MAX_TAXELS";
    }
    if (palpate_has_lines(about) && (size_t)about->rows + about->columns > PALPATE_MAX_LINES) {
        return "more rows and columns than PALPATE_MAX_LINES";
    }
    if (palpate_has_lines(about) && (about->column_places == NULL || about->row_heights == NULL)) {
        return "places of columns and rows are missing";
    }
    if (!palpate_has_lines(about) && !about->has_geometry) {
        return "a free array must have geometry";
    }
    if (about->bit_depth < 1 || about->bit_depth > 16) {
        return "bit depth must be 1 to 16";
    }
    if (about->max_rate_mhz == 0 || about->max_rate_mhz > 1000000000u) {
        return "maximum rate must be 1 to 10^9 thousandths of a frame per second";
    }
    if (about->firmware == NULL || strlen(about->firmware) > PALPATE_MAX_NAME) {
        return "firmware name is missing, or longer than PALPATE_MAX_NAME";
    }
    return NULL;
}

const char *palpate_init(struct palpate_array *array, const struct palpate_description *about,
                         void *port) {
    memset(array, 0, sizeof *array);
    const char *const wrong = problem(about);
    if (wrong == NULL) {
        array->about = about;
        array->port = port;
        array->largest = (uint16_t)((1uL << about->bit_depth) - 1u);
    }
    return wrong;
}

/* ---- frames ---- */

bool palpate_next_us(const struct palpate_array *array, uint64_t *next_us) {
    *next_us = array->pace.next_us;
    return array->pace.is_streaming;
}

static void send_frame(struct palpate_array *array, uint64_t now_us) {
    const struct palpate_tare *tare = &array->tare;
    const size_t count = palpate_taxels(array);
    const struct palpate_header header = {
        .type = PALPATE_FRAME,
        .flags = tare->is_tared ? PALPATE_FLAG_TARED : 0u,
        .time_us = now_us,
        .length = (uint16_t)PALPATE_FRAME_PAYLOAD(count),
    };
    struct palpate_writer writer;
    palpate_begin_message(array, &writer, header);
    palpate_put_u8(&writer, array->about->rows);
    palpate_put_u8(&writer, array->about->columns);
    for (size_t i = 0; i < count; i++) {
        palpate_put_u16(&writer, palpate_tare_count(tare, i, array->counts[i], array->largest));
    }
    palpate_end(&writer);
    array->counters.frames++;
}

/* A number is used up, and the gap tells the host. */
static void give_up_frame(struct palpate_array *array) {
    array->sequence++;
    array->counters.given_up++;
}

static void take_frame(struct palpate_array *array, uint64_t now_us) {
    const size_t count = palpate_taxels(array);
    if (!palpate_port_sample(array->port, array->counts, count)) {
        give_up_frame(array);
        return;
    }
    /* an answer that waits for room goes first */
    if (!array->receiver.is_waiting && palpate_fits(array, PALPATE_FRAME_PAYLOAD(count))) {
        send_frame(array, now_us);
    } else {
        give_up_frame(array);
    }
    palpate_tare_add(&array->tare, array->counts, count);
}

static void keep_pace(struct palpate_array *array) {
    struct palpate_pace *pace = &array->pace;
    const uint64_t now_us = palpate_port_clock_us(array->port);
    if (!pace->is_streaming || now_us < pace->next_us) {
        return;
    }
    take_frame(array, now_us);
    palpate_pace_step(pace);
    while (pace->next_us <= now_us) { /* polled too late for these */
        give_up_frame(array);
        palpate_pace_step(pace);
    }
}

/* ---- requests ---- */

static bool is_known(const struct palpate_array *array, uint8_t type) {
    switch (type) {
    case PALPATE_HELLO:
    case PALPATE_START:
    case PALPATE_STOP:
    case PALPATE_RATE:
    case PALPATE_TARE: return true;
    case PALPATE_SELF_TEST: return array->about->has_self_test;
    case PALPATE_GEOMETRY: return array->about->has_geometry;
    default: return false;
    }
}

static bool is_payload_good(const struct palpate_array *array, uint8_t type) {
    const uint8_t *bytes = palpate_request_payload(&array->receiver);
    const size_t length = palpate_request_length(&array->receiver);
    switch (type) {
    case PALPATE_START:
    case PALPATE_RATE: return length == 6;
    case PALPATE_TARE:
        return length == 6 && palpate_get_u16(bytes + 2) <= PALPATE_MAX_SAMPLES &&
               palpate_get_u16(bytes + 4) <= array->largest;
    case PALPATE_GEOMETRY: return length == 4 && palpate_get_u16(bytes + 2) < palpate_taxels(array);
    default: return length == 2;
    }
}

/* Why the request cannot be done, in the page's order: version, type, payload, rate, state. */
static enum palpate_reason refusal(const struct palpate_array *array) {
    const uint8_t type = array->receiver.bytes[1];
    if (array->receiver.bytes[0] != PALPATE_VERSION) {
        return PALPATE_BAD_VERSION;
    }
    if (!is_known(array, type)) {
        return PALPATE_UNKNOWN_TYPE;
    }
    if (!is_payload_good(array, type)) {
        return PALPATE_BAD_PAYLOAD;
    }
    if (type == PALPATE_START || type == PALPATE_RATE) {
        const uint32_t rate = palpate_get_u32(palpate_request_payload(&array->receiver) + 2);
        if (rate == 0 || rate > array->about->max_rate_mhz) {
            return PALPATE_BAD_RATE;
        }
    }
    if (type == PALPATE_RATE && !array->pace.is_streaming) {
        return PALPATE_BAD_STATE;
    }
    if (type == PALPATE_SELF_TEST && array->pace.is_streaming) {
        return PALPATE_BAD_STATE;
    }
    return PALPATE_NO_REASON;
}

static void stop_stream(struct palpate_array *array) {
    array->pace.is_streaming = false;
    (void)palpate_port_stream(array->port, false);
}

static void do_hello(struct palpate_array *array) {
    stop_stream(array);
    palpate_tare_clear(&array->tare);
    palpate_send_describe(array);
}

static void do_start(struct palpate_array *array, uint32_t rate_mhz) {
    if (!palpate_port_stream(array->port, true)) {
        palpate_send_nack(array, PALPATE_HARDWARE);
        return;
    }
    palpate_send_ack(array);
    palpate_pace_start(&array->pace, rate_mhz, palpate_port_clock_us(array->port));
}

static void do_tare(struct palpate_array *array, uint16_t samples, uint16_t pedestal) {
    if (samples == 0) {
        palpate_tare_clear(&array->tare);
    } else {
        palpate_tare_begin(&array->tare, samples, pedestal);
    }
    palpate_send_ack(array);
}

static void do_self_test(struct palpate_array *array) {
    uint16_t result = 0;
    uint8_t *kinds = (uint8_t *)array->counts; /* no frame is being sampled meanwhile */
    memset(kinds, PALPATE_GOOD, palpate_taxels(array));
    if (palpate_port_self_test(array->port, &result, kinds, palpate_taxels(array))) {
        palpate_send_report(array, result, kinds);
    } else {
        palpate_send_nack(array, PALPATE_HARDWARE);
    }
}

static void answer(struct palpate_array *array) {
    const uint8_t *bytes = palpate_request_payload(&array->receiver);
    const enum palpate_reason reason = refusal(array);
    if (reason != PALPATE_NO_REASON) {
        palpate_send_nack(array, reason);
        return;
    }
    switch (array->receiver.bytes[1]) {
    case PALPATE_HELLO: do_hello(array); break;
    case PALPATE_START: do_start(array, palpate_get_u32(bytes + 2)); break;
    case PALPATE_STOP:
        stop_stream(array);
        palpate_send_ack(array);
        break;
    case PALPATE_RATE:
        palpate_pace_change(&array->pace, palpate_get_u32(bytes + 2),
                            palpate_port_clock_us(array->port));
        palpate_send_ack(array);
        break;
    case PALPATE_TARE: do_tare(array, palpate_get_u16(bytes + 2), palpate_get_u16(bytes + 4)); break;
    case PALPATE_SELF_TEST: do_self_test(array); break;
    default: palpate_send_places(array, palpate_get_u16(bytes + 2)); break;
    }
}

/* A request is carried out once its answer has room; what it says does not happen before it is said. */
static void answer_waiting(struct palpate_array *array) {
    if (array->receiver.is_waiting && palpate_fits(array, palpate_answer_length(array))) {
        answer(array);
        palpate_receiver_clear(&array->receiver);
    }
}

/* ---- receiving ---- */

static void receive(struct palpate_array *array) {
    for (int i = 0; i < READ_AT_ONCE; i++) {
        uint8_t byte;
        answer_waiting(array);
        if (array->receiver.is_waiting || !palpate_port_read(array->port, &byte)) {
            return;
        }
        if (palpate_receiver_feed(&array->receiver, byte) == PALPATE_FAULT) {
            array->counters.faults++;
        }
    }
    answer_waiting(array);
}

/* ---- polling ---- */

static void flush(struct palpate_array *array) {
    struct palpate_ring *ring = &array->ring;
    while (ring->used > 0) {
        const size_t to_end = sizeof ring->bytes - ring->first;
        const size_t whole = ring->used < to_end ? ring->used : to_end;
        const size_t taken = palpate_port_write(array->port, ring->bytes + ring->first, whole);
        ring->first = (ring->first + taken) % sizeof ring->bytes;
        ring->used -= taken;
        if (taken < whole) {
            return;
        }
    }
}

void palpate_poll(struct palpate_array *array) {
    flush(array);
    receive(array);
    keep_pace(array);
    flush(array);
}
