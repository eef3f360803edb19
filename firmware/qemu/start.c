/* From reset to main: vector table, memory, and a stack whose depth can be read off afterwards. */
#include <stdint.h>

/* Where the linker put things (cortex_m.ld). */
extern uint32_t link_data_load[], link_data[], link_data_end[], link_bss[], link_bss_end[];
extern uint32_t link_stack[], link_stack_top[];

#define UNTOUCHED 0xC5C5C5C5u /* what the stack is filled with */
#define INTERRUPTS 32         /* all that a Cortex-M0 has */

int main(void);
void on_reset(void);
void on_fault(void);
void on_systick(void);
void on_interrupt_0(void);
void on_interrupt_1(void);
void on_interrupt_2(void);
void on_interrupt_8(void);

/* A board defines those that it uses. */
#define UNUSED __attribute__((weak, alias("on_fault")))
void on_systick(void) UNUSED;
void on_interrupt_0(void) UNUSED;
void on_interrupt_1(void) UNUSED;
void on_interrupt_2(void) UNUSED;
void on_interrupt_8(void) UNUSED;

typedef void (*handler)(void);

struct vectors {
    uint32_t *stack;
    handler core[15]; /* exceptions 1 to 15 */
    handler interrupt[INTERRUPTS];
};

extern const struct vectors vectors;
__attribute__((section(".vectors"), used)) const struct vectors vectors = {
    .stack = link_stack_top,
    .core = {[0] = on_reset, [1] = on_fault, [2] = on_fault, [14] = on_systick},
    .interrupt = {[0] = on_interrupt_0,
                  [1] = on_interrupt_1,
                  [2] = on_interrupt_2,
                  [8] = on_interrupt_8},
};

static void fill(uint32_t *from, const uint32_t *end, uint32_t value) {
    while (from < end) {
        *from++ = value;
    }
}

void on_reset(void) {
    uint32_t *here;
    __asm volatile("mov %0, sp" : "=r"(here));
    fill(link_stack, here - 16, UNTOUCHED); /* not what this function and `fill` stand on */
    const uint32_t *load = link_data_load;
    for (uint32_t *data = link_data; data < link_data_end; data++) {
        *data = *load++;
    }
    fill(link_bss, link_bss_end, 0);
    (void)main();
    on_fault();
}

/* Nothing here can go on: be found with a debugger. */
void on_fault(void) {
    for (;;) {
    }
}
