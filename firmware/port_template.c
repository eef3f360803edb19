/* What a new board fills in: copy this file and put your hardware in place of each remark. It compiles
 * as it is and makes an array of 8 x 8 taxels that never feels anything. palpate_port.h says what each
 * function must do. */
#include "palpate_port.h"

#include <string.h>

#include "palpate_array.h"

static const float columns_mm[8] = {-7.0f, -5.0f, -3.0f, -1.0f, 1.0f, 3.0f, 5.0f, 7.0f};
static const float rows_mm[8] = {1.0f, 3.0f, 5.0f, 7.0f, 9.0f, 11.0f, 13.0f, 15.0f};

static const struct palpate_description description = {
    .unique_id = {0}, /* the chip's serial number */
    .is_emulated = false,
    .shape = PALPATE_FLAT,
    .bit_depth = 12,
    .rows = 8,
    .columns = 8,
    .max_rate_mhz = 500000, /* 500 frames a second */
    .full_scale_n = 2.0f,
    .counts_per_n = 2047.5f,
    .tip_radius_mm = 0.0f,
    .column_places = columns_mm,
    .row_heights = rows_mm,
    .firmware = "template 1",
    .has_self_test = false,
    .has_geometry = false,
};

bool palpate_port_read(void *port, uint8_t *byte) {
    (void)port;
    (void)byte; /* take a byte from the receive buffer that an interrupt or USB fills */
    return false;
}

size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count) {
    (void)port;
    (void)bytes; /* hand over as many as the UART's FIFO, the DMA buffer or USB has room for */
    return count;
}

uint64_t palpate_port_clock_us(void *port) {
    (void)port; /* a free-running 1 MHz timer, extended to 64 bits */
    return 0;
}

bool palpate_port_stream(void *port, bool on) {
    (void)port;
    (void)on; /* power the sensor; say false if it does not come up */
    return true;
}

bool palpate_port_sample(void *port, uint16_t *counts, size_t count) {
    (void)port;
    memset(counts, 0, count * sizeof *counts); /* scan rows and columns */
    return true;
}

bool palpate_port_self_test(void *port, uint16_t *result, uint8_t *kinds, size_t count) {
    (void)port;
    (void)result;
    (void)kinds;
    (void)count; /* then set has_self_test */
    return false;
}

void palpate_port_place(void *port, size_t number, float place[6]) {
    (void)port; /* flat: column's place, height of the row, and facing -y; then set has_geometry */
    place[0] = columns_mm[number % description.columns];
    place[1] = 0.0f;
    place[2] = rows_mm[number / description.columns];
    place[3] = 0.0f;
    place[4] = -1.0f;
    place[5] = 0.0f;
}

int main(void) {
    static struct palpate_array array;
    if (palpate_init(&array, &description, NULL) != NULL) {
        return 1; /* light an LED */
    }
    for (;;) {
        palpate_poll(&array);
    }
}
