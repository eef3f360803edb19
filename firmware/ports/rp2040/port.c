/* Raspberry Pi Pico (RP2040), pico-sdk: a matrix of 8 x 8 taxels, USB as the serial line.
 *
 * Wiring: GP2 to GP9 drive the rows, one of them high at a time. The columns go to the inputs of a 74HC4051,
 * whose address is GP10 to GP12 and whose output goes to GP26 (ADC0), with 10 kOhm from there to ground. */
#include <string.h>

#include "hardware/adc.h"
#include "hardware/gpio.h"
#include "palpate_array.h"
#include "pico/stdlib.h"
#include "pico/stdio/driver.h"
#include "pico/stdio_usb.h"
#include "pico/unique_id.h"
#include "tusb.h"

#define ROWS 8u
#define COLUMNS 8u
#define FIRST_ROW_PIN 2u
#define FIRST_ADDRESS_PIN 10u
#define ADDRESS_PINS 3u
#define ADC_PIN 26u
#define SETTLE_US 5u /* 10 kOhm and a few 100 pF of matrix and multiplexer */

static const float columns_mm[COLUMNS] = {-7.0f, -5.0f, -3.0f, -1.0f, 1.0f, 3.0f, 5.0f, 7.0f};
static const float rows_mm[ROWS] = {1.0f, 3.0f, 5.0f, 7.0f, 9.0f, 11.0f, 13.0f, 15.0f};

static struct palpate_description description = {
    .shape = PALPATE_FLAT,
    .bit_depth = 12,
    .rows = ROWS,
    .columns = COLUMNS,
    .max_rate_mhz = 500000, /* a scan takes 64 times (5 + 2) us */
    .full_scale_n = 2.0f,   /* measure these two on your skin */
    .counts_per_n = 2047.5f,
    .column_places = columns_mm,
    .row_heights = rows_mm,
    .firmware = "pico 1",
};

/* Not getchar and putchar: these wait, and change line ends. */
bool palpate_port_read(void *port, uint8_t *byte) {
    (void)port;
    return stdio_usb.in_chars((char *)byte, 1) == 1;
}

/* What fits now does not make out_chars wait. If nobody has opened the port, bytes are dropped. */
size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count) {
    (void)port;
    if (!stdio_usb_connected()) {
        return count;
    }
    const size_t room = tud_cdc_write_available();
    const size_t taken = count < room ? count : room;
    if (taken > 0) {
        stdio_usb.out_chars((const char *)bytes, (int)taken);
    }
    return taken;
}

uint64_t palpate_port_clock_us(void *port) {
    (void)port;
    return time_us_64();
}

bool palpate_port_stream(void *port, bool on) {
    (void)port;
    (void)on;
    return true;
}

bool palpate_port_sample(void *port, uint16_t *counts, size_t count) {
    (void)port;
    (void)count;
    for (uint row = 0; row < ROWS; row++) {
        gpio_put(FIRST_ROW_PIN + row, true);
        for (uint column = 0; column < COLUMNS; column++) {
            gpio_put_masked(((1u << ADDRESS_PINS) - 1u) << FIRST_ADDRESS_PIN, column << FIRST_ADDRESS_PIN);
            busy_wait_us_32(SETTLE_US);
            *counts++ = adc_read();
        }
        gpio_put(FIRST_ROW_PIN + row, false);
    }
    return true;
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

static void set_up_pins(void) {
    for (uint pin = FIRST_ROW_PIN; pin < FIRST_ADDRESS_PIN + ADDRESS_PINS; pin++) {
        gpio_init(pin);
        gpio_set_dir(pin, true);
    }
    adc_init();
    adc_gpio_init(ADC_PIN);
    adc_select_input(ADC_PIN - 26u);
}

int main(void) {
    static struct palpate_array array;
    pico_unique_board_id_t id;
    stdio_init_all();
    set_up_pins();
    pico_get_unique_board_id(&id);
    memcpy(description.unique_id, id.id, sizeof id.id);
    if (palpate_init(&array, &description, NULL) != NULL) {
        return 1;
    }
    for (;;) {
        palpate_poll(&array);
    }
}
