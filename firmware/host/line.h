/* A pseudo-terminal, with bytes that get damaged on the way if that is wanted. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LINE_BYTES 65536

/* Flips one bit of a share of the bytes. */
struct noise {
    uint64_t state;
    uint64_t threshold; /* of 2^32 */
};

/* What was done to the bytes on their way to the host. Messages are those that were sent, whole. */
struct damage {
    uint64_t flipped_bytes;
    uint64_t flipped_messages; /* with a flipped byte in them, their delimiter included */
    uint64_t flipped_delimiters;
    bool is_hit; /* the message that is on its way */
};

struct line {
    int fd;
    int other; /* the host's side, kept open so that a host may come and go */
    uint8_t out[LINE_BYTES];
    size_t first;
    size_t used;
    size_t limit; /* of `used` */
    uint8_t in[256];
    size_t in_first;
    size_t in_used;
    struct noise to_host;
    struct noise from_host;
    struct damage damage;
};

/* Open a pseudo-terminal for raw bytes and return its path, or NULL with errno set. */
const char *line_open(struct line *line);

/* Take bytes to be sent, as many as fit; say how many. */
size_t line_put(struct line *line, const uint8_t *bytes, size_t count);

/* Take a byte that has been received. */
bool line_get(struct line *line, uint8_t *byte);

/* Move bytes to and from the pseudo-terminal, as many as can be without waiting. False if it is gone. */
bool line_move(struct line *line);

#endif
