/* Arm MPS2 with the FPGA image AN385: Cortex-M3 at 25 MHz, UART of the Cortex-M System Design Kit, SysTick. */
#include "board.h"
#include "cortex_m.h"
#include "matrix.h"

#define CLOCK_HZ 25000000u
#define BAUD 1000000u
#define TICK_US 1000u
#define RELOAD (CLOCK_HZ / 1000000u * TICK_US - 1u)

#define UART 0x40004000u
#define UART_DATA REGISTER(UART + 0x00u)
#define UART_STATE REGISTER(UART + 0x04u)
#define UART_CTRL REGISTER(UART + 0x08u)
#define UART_INTCLEAR REGISTER(UART + 0x0Cu)
#define UART_BAUDDIV REGISTER(UART + 0x10u)
#define STATE_RECEIVED 2u
#define CTRL_ALL 0x0Fu /* transmitter, receiver, and an interrupt of each */
#define INT_SENT 1u
#define INT_RECEIVED 2u
#define IRQ_RECEIVED 0u
#define IRQ_SENT 1u

struct byte_ring board_received;
struct byte_ring board_sending;
volatile uint32_t board_overruns;

static volatile uint32_t ticks_low, ticks_high;
static volatile bool is_sending;

void on_systick(void);
void on_interrupt_0(void);
void on_interrupt_1(void);

void board_start(void) {
    UART_BAUDDIV = CLOCK_HZ / BAUD;
    UART_CTRL = CTRL_ALL;
    NVIC_ISER = 1u << IRQ_RECEIVED | 1u << IRQ_SENT;
    SYST_RVR = RELOAD;
    SYST_CVR = 0;
    SYST_CSR = 7u;
}

/* ---- clock ---- */

void on_systick(void) {
    const uint32_t low = ticks_low + 1u;
    ticks_low = low;
    if (low == 0) {
        ticks_high++;
    }
}

/* Ticks that have been counted and the rest of the one that runs belong together if no tick came between
 * them, neither a counted one nor one that waits to be counted. */
uint64_t board_clock_us(void) {
    uint32_t high, low, left;
    do {
        high = ticks_high;
        low = ticks_low;
        left = SYST_CVR;
    } while ((SCB_ICSR & ICSR_PENDSTSET) != 0 || low != ticks_low || high != ticks_high);
    const uint64_t ticks = (uint64_t)high << 32 | low;
    return ticks * TICK_US + (RELOAD - left) / (CLOCK_HZ / 1000000u);
}

/* The next tick wakes it, whatever the instant. */
void board_sleep(uint64_t until_us, bool has_more) {
    (void)until_us;
    interrupts_off();
    if (!board_has_work(has_more)) {
        wait_for_interrupt();
    }
    interrupts_on();
}

/* ---- serial line ---- */

/* The interrupt is cleared first: a byte that comes after the last look must raise it again. */
void on_interrupt_0(void) {
    UART_INTCLEAR = INT_RECEIVED;
    while ((UART_STATE & STATE_RECEIVED) != 0) {
        if (!byte_ring_put(&board_received, (uint8_t)UART_DATA)) {
            board_overruns++;
        }
    }
}

static void send_next(void) {
    uint8_t byte = 0;
    is_sending = byte_ring_take(&board_sending, &byte);
    if (is_sending) {
        UART_DATA = byte;
    }
}

void on_interrupt_1(void) {
    UART_INTCLEAR = INT_SENT;
    send_next();
}

void board_send(void) {
    NVIC_ICER = 1u << IRQ_SENT;
    if (!is_sending) {
        send_next();
    }
    NVIC_ISER = 1u << IRQ_SENT;
}

/* The board has none; whoever emulates it may write one beside the matrix. */
uint32_t board_serial(void) {
    return matrix_serial();
}
