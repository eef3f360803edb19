/* A clock, a wire, an EEPROM and a probe for grbl's own source on this machine; the time is virtual.

   grbl polls while it waits: whenever it does, its interrupts are run here. Linked with --wrap, see grbl.py. */
#include "grbl.h"
#include <errno.h>
#include <poll.h>
#include <setjmp.h>
#include <unistd.h>

volatile uint8_t DDRB, DDRC, DDRD, PORTB, PORTC, PORTD, PINB = 0xff, PIND, SREG, PCICR, PCMSK0, PCMSK1;
volatile uint8_t TCCR0A, TCCR0B, TCNT0, OCR0A, TIMSK0, TCCR1A, TCCR1B, TIMSK1, TCCR2A, TCCR2B, OCR2A;
volatile uint8_t UCSR0A, UCSR0B, UBRR0H, UBRR0L, UDR0, MCUSR, WDTCSR;
volatile uint16_t OCR1A;

#define RUN_S 0.004 /* of motion between two calls of st_prep_buffer, which prepares more ahead */

typedef double (*gap_function)(double x, double y, double z, int probing);
static gap_function gap_mm; /* from the tip to the nearest thing; 0 or less: they touch */
static double clear_mm, asked[N_AXIS]; /* nothing is nearer than that to where it was asked */
static int touching, wire = -1;
static double now_s;
static unsigned char eeprom[1024];
static volatile int stopped;
static jmp_buf end; /* grbl itself never ends */

void USART_RX_vect(void);
void USART_UDRE_vect(void);
void TIMER1_COMPA_vect(void);
void TIMER0_OVF_vect(void);
void __real_st_prep_buffer(void);
uint8_t __real_serial_read(void);
void __real_serial_write(uint8_t data);
int grbl_main(void);

double host_seconds(void) { return now_s; }
void host_wait(double seconds) { now_s += seconds; }

static void look(void)
{
  double at[N_AXIS], moved = 0;
  for (int i = 0; i < N_AXIS; i++) {
    at[i] = sys_position[i] / (double)settings.steps_per_mm[i];
    moved += (at[i] - asked[i]) * (at[i] - asked[i]);
  }
  if (sqrt(moved) < clear_mm) { return; }
  clear_mm = gap_mm(at[0], at[1], at[2], sys_probe_state == PROBE_ACTIVE);
  touching = clear_mm <= 0;
  memcpy(asked, at, sizeof(at));
}

uint8_t host_pinc(void)
{
  look();
  return touching ? 0xff & ~PROBE_MASK : 0xff;
}

static void listen(int wait_ms)
{
  struct pollfd one = { wire, POLLIN, 0 };
  if (stopped) { longjmp(end, 1); }
  /* What does not fit waits in the terminal, as it would in a USB adapter. */
  while (serial_get_rx_buffer_available() && poll(&one, 1, wait_ms) > 0) {
    uint8_t byte;
    if (read(wire, &byte, 1) != 1) { usleep(2000); return; } /* nobody is at the other end */
    UDR0 = byte;
    USART_RX_vect();
    wait_ms = 0;
  }
}

void __wrap_st_prep_buffer(void)
{
  __real_st_prep_buffer();
  double until = now_s + RUN_S;
  while ((TIMSK1 & (1 << OCIE1A)) && now_s < until) {
    TIMER1_COMPA_vect();
    look();
    now_s += (OCR1A + 1.0) / F_CPU;
    TIMER0_OVF_vect();
  }
  listen(0);
}

uint8_t __wrap_serial_read(void)
{
  uint8_t data = __real_serial_read();
  if (data == SERIAL_NO_DATA) {
    listen(sys.state == STATE_IDLE && !plan_get_current_block() && !sys_rt_exec_state ? 2 : 0);
    data = __real_serial_read();
  }
  return data;
}

void __wrap_serial_write(uint8_t data)
{
  __real_serial_write(data);
  while (UCSR0B & (1 << UDRIE0)) {
    USART_UDRE_vect();
    uint8_t byte = UDR0;
    while (write(wire, &byte, 1) < 0 && errno == EAGAIN) { usleep(100); }
  }
}

unsigned char eeprom_get_char(unsigned int at) { return eeprom[at]; }
void eeprom_put_char(unsigned int at, unsigned char value) { eeprom[at] = value; }

static unsigned char check_of(const char *data, unsigned int size)
{
  unsigned char sum = 0;
  while (size--) { sum = (unsigned char)((sum << 1 | sum >> 7) + *data++); }
  return sum;
}

void memcpy_to_eeprom_with_checksum(unsigned int at, char *source, unsigned int size)
{
  memcpy(eeprom + at, source, size);
  eeprom[at + size] = check_of(source, size);
}

int memcpy_from_eeprom_with_checksum(char *to, unsigned int at, unsigned int size)
{
  memcpy(to, eeprom + at, size);
  return eeprom[at + size] == check_of(to, size);
}

void host_run(int file, gap_function function)
{
  wire = file;
  gap_mm = function;
  memset(eeprom, 0xff, sizeof(eeprom));
  if (!setjmp(end)) { grbl_main(); }
}

void host_stop(void) { stopped = 1; }
