#include "line.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

const char *line_open(struct line *line) {
    line->fd = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (line->fd < 0 || grantpt(line->fd) != 0 || unlockpt(line->fd) != 0) {
        return NULL;
    }
    const char *path = ptsname(line->fd);
    line->other = path == NULL ? -1 : open(path, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (line->other < 0 || tcgetattr(line->other, &raw) != 0) {
        return NULL;
    }
    cfmakeraw(&raw);
    return tcsetattr(line->other, TCSANOW, &raw) == 0 ? path : NULL;
}

/* xorshift64* by S. Vigna (An experimental exploration of Marsaglia's xorshift generators, scrambled,
 * 2016). */
static uint32_t draw(struct noise *noise) {
    uint64_t x = noise->state;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    noise->state = x;
    return (uint32_t)((x * 0x2545F4914F6CDD1Du) >> 32);
}

static uint8_t through(struct noise *noise, uint8_t byte) {
    if (noise->threshold == 0 || draw(noise) >= noise->threshold) {
        return byte;
    }
    return (uint8_t)(byte ^ (1u << (draw(noise) & 7u)));
}

static void note(struct damage *damage, uint8_t was, uint8_t is) {
    if (was != is) {
        damage->flipped_bytes++;
        damage->flipped_delimiters += was == 0 ? 1u : 0u;
        damage->is_hit = true;
    }
    if (was == 0) {
        damage->flipped_messages += damage->is_hit ? 1u : 0u;
        damage->is_hit = false;
    }
}

size_t line_put(struct line *line, const uint8_t *bytes, size_t count) {
    size_t taken = 0;
    while (taken < count && line->used < line->limit) {
        const uint8_t damaged = through(&line->to_host, bytes[taken]);
        note(&line->damage, bytes[taken], damaged);
        line->out[(line->first + line->used) % LINE_BYTES] = damaged;
        line->used++;
        taken++;
    }
    return taken;
}

bool line_get(struct line *line, uint8_t *byte) {
    if (line->in_first == line->in_used) {
        return false;
    }
    *byte = through(&line->from_host, line->in[line->in_first++]);
    return true;
}

/* What a call that must not wait moved: -1 if the pseudo-terminal is gone. */
static ssize_t moved(ssize_t result) {
    if (result < 0 && (errno == EAGAIN || errno == EINTR)) {
        return 0;
    }
    return result;
}

static bool send_out(struct line *line) {
    while (line->used > 0) {
        const size_t to_end = LINE_BYTES - line->first;
        const size_t whole = line->used < to_end ? line->used : to_end;
        const ssize_t sent = moved(write(line->fd, line->out + line->first, whole));
        if (sent <= 0) {
            return sent == 0;
        }
        line->first = (line->first + (size_t)sent) % LINE_BYTES;
        line->used -= (size_t)sent;
    }
    return true;
}

bool line_move(struct line *line) {
    if (line->in_first == line->in_used) {
        const ssize_t got = moved(read(line->fd, line->in, sizeof line->in));
        if (got < 0) {
            return false;
        }
        line->in_first = 0;
        line->in_used = (size_t)got;
    }
    return send_out(line);
}
