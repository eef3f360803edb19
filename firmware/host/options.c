#include "options.h"

#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "palpate-array-host: a tactile array on a pseudo-terminal, whose path it prints on stdout.\n"
    "Serves until stdin closes or SIGTERM comes; then it says on stderr, as JSON, how it went.\n"
    "\n"
    "  --rows R --cols C    taxels, 8 x 8 unless told otherwise, 4096 at most\n"
    "  --shape S            flat (default), cylinder or free\n"
    "  --depth B            bits of a count, 1 to 16 (default)\n"
    "  --rate-max HZ        maximum rate, 1000 unless told otherwise\n"
    "  --frames N           sample N frames, no more; then the device's clock stands still\n"
    "  --fast               a frame whenever the line has room, a period of the device's time each\n"
    "  --flip P             flip one bit of a share P of the bytes to the host\n"
    "  --flip-in P          the same of the bytes from the host\n"
    "  --seed N             of the flips and the unique id\n"
    "  --stuck R,C,KIND     a bad taxel: low, high or unsteady; as often as wanted\n"
    "  --plain              SELF_TEST and GEOMETRY are unknown\n"
    "  --broken             START and SELF_TEST find the hardware broken\n";

static void fail(const char *option, const char *given) {
    fprintf(stderr, "palpate-array-host: --%s does not take '%s'; see --help\n", option, given);
    exit(2);
}

static double real(const char *option, const char *text, double least, double most) {
    char *end;
    const double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(value >= least && value <= most)) {
        fail(option, text);
    }
    return value;
}

static uint64_t whole(const char *option, const char *text, uint64_t least, uint64_t most) {
    char *end;
    const unsigned long long value = strtoull(text, &end, 10);
    if (end == text || *end != '\0' || text[0] == '-' || value < least || value > most) {
        fail(option, text);
    }
    return value;
}

/* Place of a word in a list that ends with NULL. */
static int word(const char *option, const char *text, const char *const *words) {
    for (int i = 0; words[i] != NULL; i++) {
        if (strcmp(text, words[i]) == 0) {
            return i;
        }
    }
    fail(option, text);
    return -1;
}

static void add_stuck(struct options *options, const char *text) {
    static const char *const kinds[] = {"good", "low", "high", "unsteady", NULL};
    unsigned row;
    unsigned column;
    char kind[9];
    char more;
    if (options->stuck_count == MAX_STUCK ||
        sscanf(text, "%3u,%3u,%8[a-z]%c", &row, &column, kind, &more) != 3 || row > 254 ||
        column > 254) {
        fail("stuck", text);
    }
    options->stuck[options->stuck_count++] = (struct stuck){
        (uint8_t)row,
        (uint8_t)column,
        (enum palpate_kind)word("stuck", kind, kinds),
    };
}

static void set(struct options *options, int letter, const char *given) {
    static const char *const shapes[] = {"flat", "cylinder", "free", NULL};
    switch (letter) {
    case 'r': options->rows = (uint8_t)whole("rows", given, 1, 255); break;
    case 'c': options->columns = (uint8_t)whole("cols", given, 1, 255); break;
    case 's': options->shape = (enum palpate_shape)word("shape", given, shapes); break;
    case 'd': options->depth = (uint8_t)whole("depth", given, 1, 16); break;
    case 'm':
        options->max_rate_mhz = (uint32_t)lround(real("rate-max", given, 0.001, 1e6) * 1000.0);
        break;
    case 'n': options->frames = whole("frames", given, 0, UINT64_MAX); break;
    case 'f': options->is_fast = true; break;
    case 'o': options->flip = real("flip", given, 0.0, 1.0); break;
    case 'i': options->flip_in = real("flip-in", given, 0.0, 1.0); break;
    case 'e': options->seed = whole("seed", given, 0, UINT64_MAX); break;
    case 't': add_stuck(options, given); break;
    case 'p': options->is_plain = true; break;
    case 'b': options->is_broken = true; break;
    case 'h': fputs(usage, stdout); exit(0);
    default: exit(2); /* getopt has said why */
    }
}

struct options options_read(int argc, char **argv) {
    static const struct option known[] = {
        {"rows", 1, NULL, 'r'},   {"cols", 1, NULL, 'c'},     {"shape", 1, NULL, 's'},
        {"depth", 1, NULL, 'd'},  {"rate-max", 1, NULL, 'm'}, {"frames", 1, NULL, 'n'},
        {"fast", 0, NULL, 'f'},   {"flip", 1, NULL, 'o'},     {"flip-in", 1, NULL, 'i'},
        {"seed", 1, NULL, 'e'},   {"stuck", 1, NULL, 't'},    {"plain", 0, NULL, 'p'},
        {"broken", 0, NULL, 'b'}, {"help", 0, NULL, 'h'},     {NULL, 0, NULL, 0},
    };
    struct options options = {.rows = 8, .columns = 8, .depth = 16, .max_rate_mhz = 1000000};
    int letter;
    while ((letter = getopt_long(argc, argv, "", known, NULL)) != -1) {
        set(&options, letter, optarg);
    }
    if (optind < argc) {
        fprintf(stderr, "palpate-array-host: '%s' is no option; see --help\n", argv[optind]);
        exit(2);
    }
    return options;
}
