// On this computer there is one memory.
#ifndef AVR_PGMSPACE_H_
#define AVR_PGMSPACE_H_

#define PROGMEM
#define pgm_read_word_near(address) (*(const unsigned short *)(address))

#endif
