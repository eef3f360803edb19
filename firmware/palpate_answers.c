#include "palpate_answers.h"

#include <string.h>

size_t palpate_taxels(const struct palpate_array *array) {
    return (size_t)array->about->rows * array->about->columns;
}

bool palpate_has_lines(const struct palpate_description *about) {
    return about->shape != PALPATE_FREE;
}

bool palpate_fits(const struct palpate_array *array, size_t payload) {
    return palpate_ring_fits(&array->ring, PALPATE_ENCODED(payload));
}

void palpate_begin_message(struct palpate_array *array, struct palpate_writer *writer,
                           struct palpate_header header) {
    header.version = PALPATE_VERSION;
    header.sequence = array->sequence++;
    palpate_begin(writer, &array->ring, &header);
}

static void begin_answer(struct palpate_array *array, struct palpate_writer *writer, uint8_t type,
                         size_t length) {
    const struct palpate_header header = {
        .type = type,
        .time_us = palpate_port_clock_us(array->port),
        .length = (uint16_t)length,
    };
    palpate_begin_message(array, writer, header);
    palpate_put(writer, array->receiver.bytes + PALPATE_HEADER, 2); /* the request's number */
    array->counters.requests++;
}

void palpate_send_ack(struct palpate_array *array) {
    struct palpate_writer writer;
    begin_answer(array, &writer, PALPATE_ACK, 2);
    palpate_end(&writer);
}

void palpate_send_nack(struct palpate_array *array, enum palpate_reason reason) {
    struct palpate_writer writer;
    begin_answer(array, &writer, PALPATE_NACK, 3);
    palpate_put_u8(&writer, (uint8_t)reason);
    palpate_end(&writer);
}

static size_t describe_length(const struct palpate_description *about) {
    const size_t lines = palpate_has_lines(about) ? (size_t)about->rows + about->columns : 0u;
    return PALPATE_DESCRIBE_PAYLOAD(lines, strlen(about->firmware));
}

void palpate_send_describe(struct palpate_array *array) {
    const struct palpate_description *about = array->about;
    const size_t name = strlen(about->firmware);
    struct palpate_writer writer;
    begin_answer(array, &writer, PALPATE_DESCRIBE, describe_length(about));
    palpate_put(&writer, about->unique_id, sizeof about->unique_id);
    palpate_put_u8(&writer, about->is_emulated ? 1u : 0u);
    palpate_put_u8(&writer, (uint8_t)about->shape);
    palpate_put_u8(&writer, about->bit_depth);
    palpate_put_u8(&writer, about->rows);
    palpate_put_u8(&writer, about->columns);
    palpate_put_u32(&writer, about->max_rate_mhz);
    palpate_put_real(&writer, about->full_scale_n);
    palpate_put_real(&writer, about->counts_per_n);
    palpate_put_real(&writer, about->tip_radius_mm);
    if (palpate_has_lines(about)) {
        for (size_t i = 0; i < about->columns; i++) {
            palpate_put_real(&writer, about->column_places[i]);
        }
        for (size_t i = 0; i < about->rows; i++) {
            palpate_put_real(&writer, about->row_heights[i]);
        }
    }
    palpate_put_u8(&writer, (uint8_t)name);
    palpate_put(&writer, (const uint8_t *)about->firmware, name);
    palpate_end(&writer);
}

size_t palpate_places_told(const struct palpate_array *array, size_t first) {
    const size_t left = palpate_taxels(array) - first;
    return left < PALPATE_MAX_PLACES ? left : PALPATE_MAX_PLACES;
}

void palpate_send_places(struct palpate_array *array, size_t first) {
    const size_t count = palpate_places_told(array, first);
    struct palpate_writer writer;
    begin_answer(array, &writer, PALPATE_PLACES, PALPATE_TAXELS_PAYLOAD(count));
    palpate_put_u16(&writer, (uint16_t)first);
    palpate_put_u8(&writer, (uint8_t)count);
    for (size_t i = 0; i < count; i++) {
        float place[6];
        palpate_port_place(array->port, first + i, place);
        for (size_t k = 0; k < 6; k++) {
            palpate_put_real(&writer, place[k]);
        }
    }
    palpate_end(&writer);
}

void palpate_send_report(struct palpate_array *array, uint16_t result, const uint8_t *kinds) {
    size_t bad = 0;
    for (size_t i = 0; i < palpate_taxels(array); i++) {
        bad += kinds[i] != PALPATE_GOOD ? 1u : 0u;
    }
    size_t listed = bad < PALPATE_MAX_BAD ? bad : PALPATE_MAX_BAD;
    struct palpate_writer writer;
    begin_answer(array, &writer, PALPATE_REPORT, PALPATE_REPORT_PAYLOAD(listed));
    palpate_put_u16(&writer, (uint16_t)(result | (bad > 0 ? PALPATE_TAXELS : 0u)));
    palpate_put_u16(&writer, (uint16_t)bad);
    for (size_t i = 0; listed > 0; i++) {
        if (kinds[i] != PALPATE_GOOD) {
            palpate_put_u8(&writer, (uint8_t)(i / array->about->columns));
            palpate_put_u8(&writer, (uint8_t)(i % array->about->columns));
            palpate_put_u8(&writer, kinds[i]);
            listed--;
        }
    }
    palpate_end(&writer);
}

size_t palpate_answer_length(const struct palpate_array *array) {
    switch (array->receiver.bytes[1]) {
    case PALPATE_HELLO: return describe_length(array->about);
    case PALPATE_SELF_TEST:
        return PALPATE_REPORT_PAYLOAD(palpate_taxels(array) < PALPATE_MAX_BAD ? palpate_taxels(array)
                                                                              : PALPATE_MAX_BAD);
    case PALPATE_GEOMETRY: return PALPATE_TAXELS_PAYLOAD(palpate_places_told(array, 0));
    default: return 3;
    }
}
