/* STM32 with ST's HAL, written for a Nucleo-F446RE: a matrix of 8 x 8 taxels, the ST-LINK's serial port.
 *
 * Let CubeMX make the project: USART2 at 1 Mbit/s with its interrupt enabled; TIM2 (32 bit) with a prescaler
 * that makes it count at 1 MHz, and the largest period; ADC1 with one channel, 12 bit, software start; output
 * pins for eight rows and three address lines on one port each. Add this file and palpate_*.c, call
 * palpate_board_start() once after the MX_..._Init() and palpate_board_poll() in the loop of main().
 *
 * Wiring: PB0 to PB7 drive the rows, one of them high at a time. The columns go to the inputs of a 74HC4051,
 * whose address is PC0 to PC2 and whose output goes to PA0 (ADC1_IN0), with 10 kOhm from there to ground. */
#include <string.h>

#include "main.h" /* CubeMX's: the HAL of this chip */
#include "palpate_array.h"
#include "ports/byte_ring.h"

extern UART_HandleTypeDef huart2;
extern TIM_HandleTypeDef htim2;
extern ADC_HandleTypeDef hadc1;

void palpate_board_start(void);
void palpate_board_poll(void);

#define ROWS 8u
#define COLUMNS 8u
#define ROW_PORT GPIOB
#define ADDRESS_PORT GPIOC
#define ADDRESS_MASK 7u
#define SETTLE_US 5u /* 10 kOhm and a few 100 pF of matrix and multiplexer */
#define CHUNK 128u

static const float columns_mm[COLUMNS] = {-7.0f, -5.0f, -3.0f, -1.0f, 1.0f, 3.0f, 5.0f, 7.0f};
static const float rows_mm[ROWS] = {1.0f, 3.0f, 5.0f, 7.0f, 9.0f, 11.0f, 13.0f, 15.0f};

static struct palpate_description description = {
    .shape = PALPATE_FLAT,
    .bit_depth = 12,
    .rows = ROWS,
    .columns = COLUMNS,
    .max_rate_mhz = 500000,
    .full_scale_n = 2.0f, /* measure these two on your skin */
    .counts_per_n = 2047.5f,
    .column_places = columns_mm,
    .row_heights = rows_mm,
    .firmware = "stm32 1",
};

static struct palpate_array array;
static struct byte_ring received;
static uint8_t incoming;
static uint8_t outgoing[CHUNK];

/* ---- serial line: interrupts of the HAL, a byte at a time in and a chunk at a time out ---- */

void HAL_UART_RxCpltCallback(UART_HandleTypeDef *uart) {
    if (uart == &huart2) {
        (void)byte_ring_put(&received, incoming);
        (void)HAL_UART_Receive_IT(uart, &incoming, 1);
    }
}

/* Noise or a byte that came too early: the HAL has given up receiving. */
void HAL_UART_ErrorCallback(UART_HandleTypeDef *uart) {
    if (uart == &huart2) {
        (void)HAL_UART_Receive_IT(uart, &incoming, 1);
    }
}

bool palpate_port_read(void *port, uint8_t *byte) {
    (void)port;
    return byte_ring_take(&received, byte);
}

size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count) {
    (void)port;
    const size_t taken = count < CHUNK ? count : CHUNK;
    if (huart2.gState != HAL_UART_STATE_READY) {
        return 0;
    }
    memcpy(outgoing, bytes, taken);
    return HAL_UART_Transmit_IT(&huart2, outgoing, (uint16_t)taken) == HAL_OK ? taken : 0;
}

/* ---- clock: wraps after 71 minutes, and palpate_poll looks at it far more often ---- */

uint64_t palpate_port_clock_us(void *port) {
    static uint32_t before, turns;
    (void)port;
    const uint32_t now = __HAL_TIM_GET_COUNTER(&htim2);
    turns += now < before ? 1u : 0u;
    before = now;
    return (uint64_t)turns << 32 | now;
}

static void wait_us(uint32_t span_us) {
    const uint32_t begin = __HAL_TIM_GET_COUNTER(&htim2);
    while (__HAL_TIM_GET_COUNTER(&htim2) - begin <= span_us) {
    }
}

/* ---- taxels ---- */

bool palpate_port_stream(void *port, bool on) {
    (void)port;
    (void)on;
    return true;
}

static bool convert(uint16_t *count) {
    wait_us(SETTLE_US);
    if (HAL_ADC_Start(&hadc1) != HAL_OK || HAL_ADC_PollForConversion(&hadc1, 1) != HAL_OK) {
        return false;
    }
    *count = (uint16_t)HAL_ADC_GetValue(&hadc1);
    return true;
}

/* BSRR: the lower half sets pins, the upper half clears them. */
bool palpate_port_sample(void *port, uint16_t *counts, size_t count) {
    (void)port;
    (void)count;
    for (uint32_t row = 0; row < ROWS; row++) {
        ROW_PORT->BSRR = 1u << row;
        for (uint32_t column = 0; column < COLUMNS; column++) {
            ADDRESS_PORT->BSRR = ADDRESS_MASK << 16 | column;
            if (!convert(counts++)) {
                ROW_PORT->BSRR = 1u << (row + 16u);
                return false;
            }
        }
        ROW_PORT->BSRR = 1u << (row + 16u);
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

/* ---- called from CubeMX's main ---- */

void palpate_board_start(void) {
    const uint32_t id[3] = {HAL_GetUIDw0(), HAL_GetUIDw1(), HAL_GetUIDw2()};
    memcpy(description.unique_id, id, sizeof id);
    (void)HAL_TIM_Base_Start(&htim2);
    (void)HAL_UART_Receive_IT(&huart2, &incoming, 1);
    if (palpate_init(&array, &description, NULL) != NULL) {
        Error_Handler();
    }
}

void palpate_board_poll(void) {
    palpate_poll(&array);
}
