/* The ATmega328P as far as grbl's C source sees it: registers are variables, interrupts are functions that
   host.c calls, and the probe's pin is asked for. Stands for <avr/...> and <util/delay.h>. */
#ifndef AVR_HOST_H
#define AVR_HOST_H
#include <stdint.h>

#define PROGMEM
#define PSTR(text) (text)
#define pgm_read_byte_near(at) (*(const uint8_t *)(at))
#define ISR(vector) void vector(void)
#define sei()
#define cli()
#define _delay_ms(ms) host_wait(1e-3 * (ms))
#define _delay_us(us) host_wait(1e-6 * (us))
void host_wait(double seconds);

extern volatile uint8_t DDRB, DDRC, DDRD, PORTB, PORTC, PORTD, PINB, PIND, SREG, PCICR, PCMSK0, PCMSK1;
extern volatile uint8_t TCCR0A, TCCR0B, TCNT0, OCR0A, TIMSK0, TCCR1A, TCCR1B, TIMSK1, TCCR2A, TCCR2B, OCR2A;
extern volatile uint8_t UCSR0A, UCSR0B, UBRR0H, UBRR0L, UDR0, MCUSR, WDTCSR;
extern volatile uint16_t OCR1A;
uint8_t host_pinc(void);
#define PINC host_pinc()

enum { WGM10, WGM11, WGM12 = 3, WGM13, WGM20 = 0, WGM21, WGM22 = 3, CS00 = 0, CS01, CS02, CS10 = 0, CS11, CS12 };
enum { CS20, CS21, CS22, COM1B0 = 4, COM1B1, COM1A0, COM1A1, COM2B0 = 4, COM2B1, COM2A0, COM2A1 };
enum { TOIE0, OCIE0A, OCIE0B, OCIE1A = 1, PCIE0 = 0, PCIE1, U2X0 = 1, TXEN0 = 3, RXEN0, UDRIE0, RXCIE0 = 7 };
enum { WDE = 3, WDCE, WDIE = 6, WDP0 = 0, WDP1, WDP2 };
#endif
