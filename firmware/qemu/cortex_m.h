/* The few registers and instructions of a Cortex-M core that the boards use (ARMv6-M and ARMv7-M
 * Architecture Reference Manuals). */
#ifndef CORTEX_M_H
#define CORTEX_M_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define SYST_CSR REGISTER(0xE000E010u) /* 1 count, 2 interrupt, 4 the processor's clock */
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define NVIC_ISER REGISTER(0xE000E100u)
#define NVIC_ICER REGISTER(0xE000E180u)
#define SCB_ICSR REGISTER(0xE000ED04u)
#define ICSR_PENDSTSET (1u << 26)

static inline void interrupts_off(void) {
    __asm volatile("cpsid i" ::: "memory");
}

static inline void interrupts_on(void) {
    __asm volatile("cpsie i" ::: "memory");
}

/* Sleep until an interrupt is pending, also if interrupts are off: it is served once they are on. */
static inline void wait_for_interrupt(void) {
    __asm volatile("dsb\n\twfi" ::: "memory");
}

#endif
