/* Random and mutated bytes into the firmware, under sanitizers: `fuzz SEED MESSAGES`.
 *
 * Whatever comes in, what goes out must be whole messages with the right CRC and rising numbers, and a
 * good HELLO behind a delimiter must be answered. Ends with 1, and says why, if not; else prints what
 * was tried. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "palpate_array.h"

struct world {
    struct palpate_array array;
    uint64_t random;
    uint64_t clock_us;
    uint8_t in[256];
    size_t in_first;
    size_t in_used;
    size_t room; /* bytes that the line takes before the next poll */
    uint8_t message[PALPATE_TX_BYTES];
    size_t used;
    uint32_t next; /* number that the next message has at least */
    uint32_t answered[256];
    unsigned long bytes_in;
    bool has_described;
};

static const float lines[8] = {0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f};

static struct palpate_description description = {
    .shape = PALPATE_FLAT,
    .bit_depth = 12,
    .rows = 8,
    .columns = 8,
    .max_rate_mhz = 1000000,
    .column_places = lines,
    .row_heights = lines,
    .firmware = "fuzz",
    .has_self_test = true,
    .has_geometry = true,
};

static uint32_t draw(struct world *world) {
    uint64_t x = world->random;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    world->random = x;
    return (uint32_t)((x * 0x2545F4914F6CDD1Du) >> 32);
}

static uint32_t below(struct world *world, uint32_t limit) {
    return draw(world) % limit;
}

static void fail(const char *why) {
    printf("%s\n", why);
    exit(1);
}

/* ---- what comes out ---- */

static void check(struct world *world) {
    size_t plain;
    if (!palpate_cobs_decode(world->message, world->used, &plain) || plain < PALPATE_OVERHEAD) {
        fail("what was sent is no message");
    }
    const uint8_t *bytes = world->message;
    if (palpate_crc32(0, bytes, plain - PALPATE_CRC) != palpate_get_u32(bytes + plain - PALPATE_CRC)) {
        fail("what was sent has a wrong CRC");
    }
    if (palpate_get_u16(bytes + 16) != plain - PALPATE_OVERHEAD) {
        fail("what was sent has a wrong length");
    }
    if (palpate_get_u32(bytes + 4) < world->next) {
        fail("a number was used twice");
    }
    world->next = palpate_get_u32(bytes + 4) + 1;
    world->answered[bytes[1]]++;
    world->has_described = world->has_described || bytes[1] == PALPATE_DESCRIBE;
}

size_t palpate_port_write(void *port, const uint8_t *bytes, size_t count) {
    struct world *world = port;
    const size_t taken = count < world->room ? count : world->room;
    for (size_t i = 0; i < taken; i++) {
        if (bytes[i] != 0) {
            world->message[world->used++] = bytes[i];
        } else {
            check(world);
            world->used = 0;
        }
    }
    world->room -= taken;
    return taken;
}

/* ---- the rest of the port ---- */

bool palpate_port_read(void *port, uint8_t *byte) {
    struct world *world = port;
    if (world->in_first == world->in_used) {
        return false;
    }
    *byte = world->in[world->in_first++];
    world->bytes_in++;
    return true;
}

uint64_t palpate_port_clock_us(void *port) {
    return ((const struct world *)port)->clock_us;
}

bool palpate_port_stream(void *port, bool on) {
    return !on || below(port, 16) != 0;
}

bool palpate_port_sample(void *port, uint16_t *counts, size_t count) {
    for (size_t i = 0; i < count; i++) {
        counts[i] = (uint16_t)below(port, 4096);
    }
    return below(port, 64) != 0;
}

bool palpate_port_self_test(void *port, uint16_t *result, uint8_t *kinds, size_t count) {
    *result = (uint16_t)draw(port);
    for (size_t i = 0; i < count; i++) {
        kinds[i] = (uint8_t)below(port, 4);
    }
    return below(port, 16) != 0;
}

void palpate_port_place(void *port, size_t number, float place[6]) {
    (void)port;
    for (size_t i = 0; i < 6; i++) {
        place[i] = (float)number;
    }
}

/* ---- what goes in ---- */

/* A message with a good CRC; its type, version, length and payload are likely to make sense. */
static size_t make(struct world *world, uint8_t *to) {
    static struct palpate_ring ring;
    static const uint8_t lengths[8] = {2, 2, 6, 2, 6, 6, 2, 4};
    uint8_t type = (uint8_t)below(world, 9);
    size_t length = lengths[type & 7u];
    type = below(world, 32) == 0 ? (uint8_t)draw(world) : type;
    length = below(world, 16) == 0 ? below(world, 24) : length;
    const struct palpate_header header = {
        .version = below(world, 32) == 0 ? (uint8_t)draw(world) : PALPATE_VERSION,
        .type = type,
        .length = below(world, 32) == 0 ? (uint16_t)draw(world) : (uint16_t)length,
    };
    struct palpate_writer writer;
    ring.first = ring.used = 0;
    palpate_begin(&writer, &ring, &header);
    for (size_t i = 0; i < length; i++) {
        const bool is_random =
            i < 3 || below(world, 4) == 0; /* rates and samples that are often allowed */
        palpate_put_u8(&writer, is_random ? (uint8_t)draw(world) : 0u);
    }
    palpate_end(&writer);
    memcpy(to, ring.bytes, ring.used);
    return ring.used;
}

static void mutate(struct world *world) {
    uint8_t *const at = world->in + below(world, (uint32_t)world->in_used);
    switch (below(world, 6)) {
    case 0: *at = (uint8_t)draw(world); break;
    case 1: *at ^= (uint8_t)(1u << below(world, 8)); break;
    case 2: *at = 0; break;
    case 3: world->in_used = 1u + (size_t)(at - world->in); break; /* cut */
    default: break;
    }
}

static void next_input(struct world *world) {
    world->in_first = world->in_used = 0;
    if (below(world, 8) == 0) {
        world->in_used = 1 + below(world, sizeof world->in - 1);
        for (size_t i = 0; i < world->in_used; i++) {
            world->in[i] = (uint8_t)draw(world);
        }
        return;
    }
    world->in_used = make(world, world->in);
    mutate(world);
}

static void poll_all(struct world *world, bool is_roomy) {
    for (int i = 0; i < 8 || (is_roomy && world->in_first < world->in_used); i++) {
        world->room = is_roomy ? sizeof world->message : below(world, 80);
        world->clock_us += below(world, 3000);
        palpate_poll(&world->array);
    }
}

/* However the receiver was left, a HELLO behind a delimiter is heard. */
static void expect_hello(struct world *world) {
    static const uint8_t hello[] = {
        0x00, 0x03, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01,
        0x01, 0x01, 0x01, 0x02, 0x02, 0x02, 0x01, 0x05, 0x59, 0xd9, 0x42, 0x0e, 0x00,
    };
    poll_all(world, true);
    memcpy(world->in, hello, sizeof hello);
    world->in_first = 0;
    world->in_used = sizeof hello;
    world->has_described = false;
    poll_all(world, true);
    if (!world->has_described) {
        fail("a HELLO was not answered");
    }
}

int main(int argc, char **argv) {
    static struct world world;
    const unsigned long messages = argc > 2 ? strtoul(argv[2], NULL, 10) : 100000;
    world.random = argc > 1 ? strtoull(argv[1], NULL, 10) + 1 : 1;
    if (palpate_init(&world.array, &description, &world) != NULL) {
        fail("the description was refused");
    }
    for (unsigned long i = 0; i < messages; i++) {
        next_input(&world);
        poll_all(&world, false);
        if (i % 32 == 0) {
            expect_hello(&world);
        }
    }
    printf("{\"bytes_in\": %lu, \"faults\": %lu, \"frames\": %lu, \"given_up\": %lu, \"acks\": %lu, "
           "\"nacks\": %lu, \"reports\": %lu, \"geometry\": %lu}\n",
           world.bytes_in, (unsigned long)world.array.counters.faults,
           (unsigned long)world.array.counters.frames, (unsigned long)world.array.counters.given_up,
           (unsigned long)world.answered[PALPATE_ACK], (unsigned long)world.answered[PALPATE_NACK],
           (unsigned long)world.answered[PALPATE_REPORT], (unsigned long)world.answered[PALPATE_PLACES]);
    return 0;
}
