/* BBC micro:bit: nRF51822 (Cortex-M0 at 16 MHz). Registers as in Nordic's nRF51 Series Reference Manual. */
#include "board.h"
#include "cortex_m.h"

#define CLOCK_START REGISTER(0x40000000u)
#define CLOCK_STARTED REGISTER(0x40000100u)

#define UART 0x40002000u
#define UART_STARTRX REGISTER(UART + 0x000u)
#define UART_STARTTX REGISTER(UART + 0x008u)
#define UART_RXDRDY REGISTER(UART + 0x108u)
#define UART_TXDRDY REGISTER(UART + 0x11Cu)
#define UART_INTENSET REGISTER(UART + 0x304u)
#define UART_ENABLE REGISTER(UART + 0x500u)
#define UART_PSELTXD REGISTER(UART + 0x50Cu)
#define UART_PSELRXD REGISTER(UART + 0x514u)
#define UART_RXD REGISTER(UART + 0x518u)
#define UART_TXD REGISTER(UART + 0x51Cu)
#define UART_BAUDRATE REGISTER(UART + 0x524u)
#define BAUD_1M 0x10000000u
#define INT_RXDRDY (1u << 2)
#define INT_TXDRDY (1u << 7)
#define IRQ_UART 2u

#define TIMER 0x40008000u
#define TIMER_START REGISTER(TIMER + 0x000u)
#define TIMER_CAPTURE_0 REGISTER(TIMER + 0x040u)
#define TIMER_COMPARE_1 REGISTER(TIMER + 0x144u)
#define TIMER_INTENSET REGISTER(TIMER + 0x304u)
#define TIMER_BITMODE REGISTER(TIMER + 0x508u)
#define TIMER_PRESCALER REGISTER(TIMER + 0x510u)
#define TIMER_CC_0 REGISTER(TIMER + 0x540u)
#define TIMER_CC_1 REGISTER(TIMER + 0x544u)
#define INT_COMPARE_1 (1u << 17)
#define IRQ_TIMER 8u

#define PIN_TXD 24u
#define PIN_RXD 25u
#define DEVICE_ID REGISTER(0x10000060u)
#define LONGEST_SLEEP_US 0x10000000u /* the clock must be looked at more often than it wraps */
#define WATCHED_SLEEP_US 1000u       /* while bytes are being sent */
#define SHORTEST_SLEEP_US 20u        /* an alarm that is set too close to now is missed */

struct byte_ring board_received;
struct byte_ring board_sending;
volatile uint32_t board_overruns;

static volatile bool is_sending;

void on_interrupt_2(void);
void on_interrupt_8(void);

void board_start(void) {
    CLOCK_START = 1; /* the crystal: the UART's rate would be off by up to 6 % without it */
    while (CLOCK_STARTED == 0) {
    }
    UART_PSELTXD = PIN_TXD;
    UART_PSELRXD = PIN_RXD;
    UART_BAUDRATE = BAUD_1M;
    UART_ENABLE = 4;
    UART_INTENSET = INT_RXDRDY | INT_TXDRDY;
    UART_STARTTX = 1;
    UART_STARTRX = 1;
    TIMER_BITMODE = 3;   /* 32 bit */
    TIMER_PRESCALER = 4; /* 16 MHz / 2^4 */
    TIMER_INTENSET = INT_COMPARE_1;
    TIMER_START = 1;
    NVIC_ISER = 1u << IRQ_UART | 1u << IRQ_TIMER;
}

/* ---- clock ---- */

/* The timer has 32 bits and wraps after 71 minutes: each turn is seen, since the board looks at it more
 * often than that. */
uint64_t board_clock_us(void) {
    static uint32_t before, turns;
    TIMER_CAPTURE_0 = 1;
    const uint32_t now = TIMER_CC_0;
    turns += now < before ? 1u : 0u;
    before = now;
    return (uint64_t)turns << 32 | now;
}

void on_interrupt_8(void) {
    TIMER_COMPARE_1 = 0;
}

/* ---- serial line ---- */

static void send_next(void) {
    uint8_t byte = 0;
    is_sending = byte_ring_take(&board_sending, &byte);
    if (is_sending) {
        UART_TXD = byte;
    }
}

static void receive(void) {
    while (UART_RXDRDY != 0) { /* set again as long as there is more */
        UART_RXDRDY = 0;
        if (!byte_ring_put(&board_received, (uint8_t)UART_RXD)) {
            board_overruns++;
        }
    }
}

void on_interrupt_2(void) {
    receive();
    if (UART_TXDRDY != 0) {
        UART_TXDRDY = 0;
        send_next();
    }
}

/* A byte that is out raises the interrupt, except in QEMU 7.2 if the host did not take it at once: then
 * only the event is set. */
void board_send(void) {
    NVIC_ICER = 1u << IRQ_UART;
    if (!is_sending || UART_TXDRDY != 0) {
        UART_TXDRDY = 0;
        send_next();
    }
    NVIC_ISER = 1u << IRQ_UART;
}

/* ---- sleep ---- */

void board_sleep(uint64_t until_us, bool has_more) {
    const uint64_t longest_us = is_sending ? WATCHED_SLEEP_US : LONGEST_SLEEP_US;
    board_send();
    const uint64_t now_us = board_clock_us();
    if (until_us < now_us + SHORTEST_SLEEP_US) {
        return;
    }
    const uint64_t left_us = until_us - now_us;
    TIMER_CC_1 = (uint32_t)(now_us + (left_us < longest_us ? left_us : longest_us));
    interrupts_off();
    if (!board_has_work(has_more)) {
        wait_for_interrupt();
    }
    interrupts_on();
}

uint32_t board_serial(void) {
    return DEVICE_ID;
}
