/* What the emulated boards have in common: a serial line, a clock and sleep. mps2.c and microbit.c fill
 * it in with registers and interrupts. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#include "ports/byte_ring.h"

/* Filled by the interrupt of the receiver; palpate_port_read takes from it. */
extern struct byte_ring board_received;

/* Filled by palpate_port_write; the interrupt of the transmitter takes from it. */
extern struct byte_ring board_sending;

/* Bytes from the host for which there was no room. */
extern volatile uint32_t board_overruns;

/* Start clock, serial line and their interrupts. */
void board_start(void);

/* Microseconds since board_start. Not from interrupts. */
uint64_t board_clock_us(void);

/* Bytes have been put into board_sending: see that the transmitter runs. */
void board_send(void);

/* Whether palpate_poll would do something now: bytes have come, or it has more of them to send than
 * board_sending could take, and now there is room. */
static inline bool board_has_work(bool has_more) {
    return !byte_ring_is_empty(&board_received) || (has_more && !byte_ring_is_full(&board_sending));
}

/* Sleep until an interrupt comes, at the latest a millisecond after `until_us` of the board's
 * clock; not at all if there is work, which is looked at once no interrupt can come in between. */
void board_sleep(uint64_t until_us, bool has_more);

/* The chip's serial number, as far as the board has one. */
uint32_t board_serial(void);

#endif
