/* Sizes of buffers, all fixed at compile time. Give others with -D, for instance
 * -DPALPATE_MAX_TAXELS=160. */
#ifndef PALPATE_SIZES_H
#define PALPATE_SIZES_H

/* Rows times columns of the largest array that this build can be. */
#ifndef PALPATE_MAX_TAXELS
#define PALPATE_MAX_TAXELS 64
#endif

/* Rows plus columns, for the positions in DESCRIBE. The default allows for 1 x n; an 8 x 8 array
 * needs 16. */
#ifndef PALPATE_MAX_LINES
#define PALPATE_MAX_LINES                                                                               \
    (PALPATE_MAX_TAXELS <= 255 ? PALPATE_MAX_TAXELS + 1 : 256 + PALPATE_MAX_TAXELS / 255)
#endif

/* Bytes of the firmware's name. */
#ifndef PALPATE_MAX_NAME
#define PALPATE_MAX_NAME 32
#endif

/* Taxels that one TAXELS tells of. */
#ifndef PALPATE_MAX_PLACES
#define PALPATE_MAX_PLACES 8
#endif

/* Encoded bytes of the longest request that is listened to; the page asks for 30 and speaks of 64. */
#ifndef PALPATE_RX_BYTES
#define PALPATE_RX_BYTES 64
#endif

#define PALPATE_HEADER 18
#define PALPATE_CRC 4
#define PALPATE_OVERHEAD (PALPATE_HEADER + PALPATE_CRC)

/* Bytes on the wire of a payload of n, at most: COBS adds one, and one more every 254; then the
 * delimiter. */
#define PALPATE_ENCODED(n) ((n) + PALPATE_OVERHEAD + ((n) + PALPATE_OVERHEAD) / 254 + 2)

#define PALPATE_MAX_BAD (PALPATE_MAX_TAXELS < 255 ? PALPATE_MAX_TAXELS : 255)
#define PALPATE_FRAME_PAYLOAD(taxels) (2 + 2 * (taxels))
#define PALPATE_REPORT_PAYLOAD(bad) (6 + 3 * (bad))
#define PALPATE_TAXELS_PAYLOAD(places) (5 + 24 * (places))
#define PALPATE_DESCRIBE_PAYLOAD(lines, name) (40 + 4 * (lines) + (name))

#define PALPATE_LARGER(a, b) ((a) > (b) ? (a) : (b))
#define PALPATE_MAX_ANSWER                                                                              \
    PALPATE_LARGER(PALPATE_DESCRIBE_PAYLOAD(PALPATE_MAX_LINES, PALPATE_MAX_NAME),                       \
                   PALPATE_LARGER(PALPATE_REPORT_PAYLOAD(PALPATE_MAX_BAD),                              \
                                  PALPATE_TAXELS_PAYLOAD(PALPATE_MAX_PLACES)))

/* What waits for the line. The default holds the longest answer and a frame. */
#ifndef PALPATE_TX_BYTES
#define PALPATE_TX_BYTES                                                                                \
    (PALPATE_ENCODED(PALPATE_MAX_ANSWER) + PALPATE_ENCODED(PALPATE_FRAME_PAYLOAD(PALPATE_MAX_TAXELS)))
#endif

/* C99 has no static assertion: an array of negative size does not compile. */
#define PALPATE_ASSERT(name, holds) typedef char palpate_assert_##name[(holds) ? 1 : -1]

PALPATE_ASSERT(taxels, PALPATE_MAX_TAXELS >= 1 && PALPATE_MAX_TAXELS <= 4096);
PALPATE_ASSERT(lines, PALPATE_MAX_LINES >= 2 && PALPATE_MAX_LINES <= 510);
PALPATE_ASSERT(name, PALPATE_MAX_NAME >= 0 && PALPATE_MAX_NAME <= 255);
PALPATE_ASSERT(places, PALPATE_MAX_PLACES >= 1 && PALPATE_MAX_PLACES <= 255);
PALPATE_ASSERT(requests_fit, PALPATE_RX_BYTES >= 30);
PALPATE_ASSERT(answers_fit, PALPATE_TX_BYTES >= PALPATE_ENCODED(PALPATE_MAX_ANSWER));
PALPATE_ASSERT(frames_fit,
               PALPATE_TX_BYTES >= PALPATE_ENCODED(PALPATE_FRAME_PAYLOAD(PALPATE_MAX_TAXELS)));
PALPATE_ASSERT(reals_are_binary32, sizeof(float) == 4);

#endif
