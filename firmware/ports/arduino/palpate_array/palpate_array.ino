/* Arduino: a matrix of 4 x 4 taxels, the board's own serial port.
 *
 * Copy firmware/palpate_*.c and palpate_*.h beside this file, then open it in the Arduino IDE. On an Uno the
 * sizes must be given, too: see boards.txt's build.extra_flags, or change palpate_sizes.h.
 *
 * Wiring: D2 to D5 drive the rows, one of them high at a time. The columns go to A0 to A3, each with 10 kOhm
 * to ground. analogRead takes 0.11 ms on an AVR: 16 taxels need 1.8 ms, 64 would need 7 ms. */
extern "C" {
#include "palpate_array.h"
}

const uint32_t BAUD = 500000; /* an AVR of 16 MHz meets this rate exactly */
const uint8_t ROWS = 4;
const uint8_t COLUMNS = 4;
const uint8_t ROW_PINS[ROWS] = {2, 3, 4, 5};
const uint8_t COLUMN_PINS[COLUMNS] = {A0, A1, A2, A3};

/* Arduino boards have no serial number: give each of yours another one. */
const uint8_t NUMBER = 1;

const float columns_mm[COLUMNS] = {-6.0f, -2.0f, 2.0f, 6.0f};
const float rows_mm[ROWS] = {2.0f, 6.0f, 10.0f, 14.0f};

struct palpate_description description;
struct palpate_array array;

extern "C" bool palpate_port_read(void *, uint8_t *byte) {
    const int found = Serial.read();
    *byte = static_cast<uint8_t>(found);
    return found >= 0;
}

extern "C" size_t palpate_port_write(void *, const uint8_t *bytes, size_t count) {
    const size_t room = static_cast<size_t>(Serial.availableForWrite());
    return Serial.write(bytes, count < room ? count : room);
}

/* micros() wraps after 71 minutes, and palpate_poll looks at it far more often. */
extern "C" uint64_t palpate_port_clock_us(void *) {
    static uint32_t before, turns;
    const uint32_t now = micros();
    turns += now < before ? 1 : 0;
    before = now;
    return static_cast<uint64_t>(turns) << 32 | now;
}

extern "C" bool palpate_port_stream(void *, bool) {
    return true;
}

extern "C" bool palpate_port_sample(void *, uint16_t *counts, size_t) {
    for (uint8_t row = 0; row < ROWS; row++) {
        digitalWrite(ROW_PINS[row], HIGH);
        for (uint8_t column = 0; column < COLUMNS; column++) {
            *counts++ = static_cast<uint16_t>(analogRead(COLUMN_PINS[column]));
        }
        digitalWrite(ROW_PINS[row], LOW);
    }
    return true;
}

extern "C" bool palpate_port_self_test(void *, uint16_t *, uint8_t *, size_t) {
    return false;
}

extern "C" void palpate_port_place(void *, size_t, float *) {
}

void describe() {
    memcpy(description.unique_id, "arduino", 7);
    description.unique_id[15] = NUMBER;
    description.shape = PALPATE_FLAT;
    description.bit_depth = 10;
    description.rows = ROWS;
    description.columns = COLUMNS;
    description.max_rate_mhz = 200000; /* 200 frames a second */
    description.full_scale_n = 2.0f;   /* measure these two on your skin */
    description.counts_per_n = 511.5f;
    description.column_places = columns_mm;
    description.row_heights = rows_mm;
    description.firmware = "arduino 1";
}

void setup() {
    Serial.begin(BAUD);
    for (uint8_t row = 0; row < ROWS; row++) {
        pinMode(ROW_PINS[row], OUTPUT);
    }
    describe();
    if (palpate_init(&array, &description, NULL) != NULL) {
        pinMode(LED_BUILTIN, OUTPUT);
        digitalWrite(LED_BUILTIN, HIGH);
        for (;;) {
        }
    }
}

void loop() {
    palpate_poll(&array);
}
