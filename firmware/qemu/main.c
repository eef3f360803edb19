/* An array of 8 x 20 taxels round a tip of 5 mm on an emulated board: the description, the port's
 * functions, and the loop that sleeps between frames. */
#include "board.h"
#include "matrix.h"
#include "palpate_array.h"

/* How it went; the tests read it out of the board's memory. */
struct account {
    const struct palpate_counters *counters;
    const volatile uint32_t *overruns;
    uint32_t frame_polls; /* calls of palpate_poll that sent a frame */
    uint32_t frame_us;    /* that they took together, interrupts among them included */
    uint32_t longest_us;  /* that one of them took */
    uint32_t asleep_us;
    uint32_t clock_us;
};

extern struct account account;
struct account account;
static struct palpate_array array;

/* 13.5 degrees apart round the tip, 2 mm along it. */
#define PLACE(k) ((float)(((k) - 9.5) * 0.2356194490192345))
static const float columns_rad[MATRIX_COLUMNS] = {
    PLACE(0),  PLACE(1),  PLACE(2),  PLACE(3),  PLACE(4),  PLACE(5),  PLACE(6),
    PLACE(7),  PLACE(8),  PLACE(9),  PLACE(10), PLACE(11), PLACE(12), PLACE(13),
    PLACE(14), PLACE(15), PLACE(16), PLACE(17), PLACE(18), PLACE(19),
};
static const float rows_mm[MATRIX_ROWS] = {1.0f, 3.0f, 5.0f, 7.0f, 9.0f, 11.0f, 13.0f, 15.0f};

static struct palpate_description description = {
    .unique_id = "palpate-qemu",
    .is_emulated = true,
    .shape = PALPATE_CYLINDER,
    .bit_depth = MATRIX_DEPTH,
    .rows = MATRIX_ROWS,
    .columns = MATRIX_COLUMNS,
    .max_rate_mhz = 500000, /* 500 frames a second */
    .full_scale_n = 4095.0f / 2000.0f,
    .counts_per_n = 2000.0f,
    .tip_radius_mm = 5.0f,
    .column_places = columns_rad,
    .row_heights = rows_mm,
    .firmware = BOARD_NAME " 1",
    .has_self_test = false,
    .has_geometry = false,
};

/* ---- palpate_port.h ---- */

bool palpate_port_read(void *port, uint8_t *byte) {
    (void)port;
    return byte_ring_take(&board_received, byte);
}

size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count) {
    (void)port;
    size_t taken = 0;
    while (taken < count && byte_ring_put(&board_sending, bytes[taken])) {
        taken++;
    }
    board_send();
    return taken;
}

uint64_t palpate_port_clock_us(void *port) {
    (void)port;
    return board_clock_us();
}

bool palpate_port_stream(void *port, bool on) {
    (void)port;
    (void)on; /* the matrix needs no power */
    return true;
}

bool palpate_port_sample(void *port, uint16_t *counts, size_t count) {
    (void)port;
    return matrix_sample(array.sequence, counts, count);
}

bool palpate_port_self_test(void *port, uint16_t *result, uint8_t *kinds, size_t count) {
    (void)port;
    (void)result;
    (void)kinds;
    (void)count;
    return false;
}

void palpate_port_place(void *port, size_t number, float place[6]) {
    (void)port;
    (void)number;
    (void)place;
}

/* ---- the loop ---- */

static void poll(void) {
    const uint32_t sent = array.counters.frames;
    const uint32_t begin_us = (uint32_t)board_clock_us();
    palpate_poll(&array);
    const uint32_t now_us = (uint32_t)board_clock_us();
    if (array.counters.frames != sent) {
        const uint32_t spent_us = now_us - begin_us;
        account.frame_polls++;
        account.frame_us += spent_us;
        account.longest_us = spent_us > account.longest_us ? spent_us : account.longest_us;
    }
    account.clock_us = now_us;
}

static void sleep(void) {
    uint64_t until_us;
    if (!palpate_next_us(&array, &until_us)) {
        until_us = UINT64_MAX;
    }
    const uint32_t begin_us = (uint32_t)board_clock_us();
    board_sleep(until_us, array.ring.used > 0);
    account.asleep_us += (uint32_t)board_clock_us() - begin_us;
}

static void set_serial(uint32_t serial) {
    for (unsigned i = 0; i < 4; i++) {
        description.unique_id[12 + i] = (uint8_t)(serial >> (8u * i));
    }
}

int main(void) {
    account.counters = &array.counters;
    account.overruns = &board_overruns;
    board_start();
    set_serial(board_serial());
    if (palpate_init(&array, &description, NULL) != NULL) {
        return 1;
    }
    for (;;) {
        poll();
        sleep();
    }
}
