/* What an array without a sensor samples, so that a host can check each frame by itself. */
#ifndef PATTERN_H
#define PATTERN_H

#include <stdint.h>

/* The count of a good taxel in the frame with this number, before it is cut to the bit depth:
 *
 *     x = number * 0x9E3779B1 + taxel * 0x85EBCA77    (mod 2^32; taxel = row * columns + column)
 *     x = (x ^ (x >> 15)) * 0x2C1B3C6D                (mod 2^32)
 *     count = (x ^ (x >> 12)) mod 2^depth
 */
static inline uint32_t frame_pattern(uint32_t number, uint32_t taxel) {
    uint32_t x = number * 0x9E3779B1u + taxel * 0x85EBCA77u;
    x = (x ^ (x >> 15)) * 0x2C1B3C6Du;
    return x ^ (x >> 12);
}

#endif
