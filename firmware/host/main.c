/* palpate-array-host: the firmware as a device in a process of its own, on a pseudo-terminal. */
#include <errno.h>
#include <inttypes.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

/* A UART's buffer, so that a host that does not read makes the array give frames up. */
#define REAL_TIME_LIMIT 4096u
#define LONGEST_WAIT_US 100000u

static volatile sig_atomic_t is_over = 0;

static void finish(int number) {
    (void)number;
    is_over = 1;
}

/* SIGTERM and SIGINT come while the process waits, and at no other time. */
static void hold_signals(void) {
    const struct sigaction action = {.sa_handler = finish};
    sigset_t held;
    sigemptyset(&held);
    sigaddset(&held, SIGTERM);
    sigaddset(&held, SIGINT);
    sigprocmask(SIG_BLOCK, &held, NULL);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
}

static struct noise noise(double share, uint64_t seed) {
    return (struct noise){
        .state = seed * 0x9E3779B97F4A7C15u + 0xD1B54A32D192ED03u,
        .threshold = (uint64_t)(share * 4294967296.0),
    };
}

/* Room for all that the firmware holds: nothing that is sampled now can be given up. */
static bool has_room(const struct board *board) {
    return board->line.limit - board->line.used >= 2u * PALPATE_TX_BYTES;
}

/* Whether the next frame need not wait: the device's time goes on as fast as the line does. */
static bool is_frame_due(const struct board *board) {
    uint64_t next_us;
    const bool is_streaming = palpate_next_us(&board->array, &next_us) && !board_is_done(board);
    return board->options.is_fast && is_streaming && has_room(board);
}

static bool has_input(const struct board *board) {
    return board->line.in_first < board->line.in_used && !board->array.receiver.is_waiting;
}

static void run(struct board *board) {
    palpate_poll(&board->array);
    while (has_input(board) || is_frame_due(board)) {
        if (is_frame_due(board)) {
            (void)palpate_next_us(&board->array, &board->device_us);
        }
        palpate_poll(&board->array);
    }
}

/* Whether a poll would do something now: bytes came, or the line has got room. */
static bool has_work(const struct board *board) {
    const bool has_output = board->array.ring.used > 0 && board->line.used < board->line.limit;
    return has_input(board) || has_output || is_frame_due(board);
}

/* How long nothing will happen by itself. */
static struct timespec patience(struct board *board) {
    uint64_t wait_us = has_work(board) ? 0u : LONGEST_WAIT_US;
    uint64_t next_us;
    if (palpate_next_us(&board->array, &next_us) && !board_is_done(board) && !board->options.is_fast) {
        const uint64_t now_us = palpate_port_clock_us(board);
        const uint64_t left_us = next_us > now_us ? next_us - now_us : 0u;
        wait_us = left_us < wait_us ? left_us : wait_us;
    }
    return (struct timespec){.tv_sec = 0, .tv_nsec = (long)wait_us * 1000L};
}

/* Wait for bytes, for room, for the next frame, or for the end; false at the end. */
static bool wait(struct board *board) {
    const bool has_bytes = board->line.used > 0;
    struct pollfd watched[2] = {
        {.fd = board->line.fd, .events = (short)(has_bytes ? POLLIN | POLLOUT : POLLIN)},
        {.fd = STDIN_FILENO, .events = POLLIN},
    };
    const struct timespec time = patience(board);
    sigset_t none;
    sigemptyset(&none);
    if (ppoll(watched, 2, &time, &none) < 0) {
        return errno == EINTR && !is_over;
    }
    if (watched[1].revents != 0) {
        char ignored[256];
        return read(STDIN_FILENO, ignored, sizeof ignored) > 0;
    }
    return !is_over;
}

static void tell(const struct board *board) {
    const struct palpate_counters *counters = &board->array.counters;
    const struct damage *damage = &board->line.damage;
    fprintf(stderr,
            "{\"numbers\": %" PRIu32 ", \"sampled\": %" PRIu64 ", \"frames\": %" PRIu32
            ", \"given_up\": %" PRIu32 ", \"answers\": %" PRIu32 ", \"faults\": %" PRIu32
            ", \"flipped_bytes\": %" PRIu64 ", \"flipped_messages\": %" PRIu64
            ", \"flipped_delimiters\": %" PRIu64 "}\n",
            board->array.sequence, board->sampled, counters->frames, counters->given_up,
            counters->requests, counters->faults, damage->flipped_bytes, damage->flipped_messages,
            damage->flipped_delimiters);
}

int main(int argc, char **argv) {
    static struct board board;
    const struct options options = options_read(argc, argv);
    hold_signals();
    const char *path = line_open(&board.line);
    if (path == NULL) {
        fprintf(stderr, "palpate-array-host: no pseudo-terminal: %s\n", strerror(errno));
        return 3;
    }
    const char *wrong = board_init(&board, &options);
    if (wrong != NULL) {
        fprintf(stderr, "palpate-array-host: %s\n", wrong);
        return 2;
    }
    board.line.limit = options.is_fast ? LINE_BYTES : REAL_TIME_LIMIT;
    board.line.to_host = noise(options.flip, options.seed);
    board.line.from_host = noise(options.flip_in, options.seed + 1);
    puts(path);
    fflush(stdout);
    bool is_there = true;
    while (is_there) {
        run(&board);
        is_there = line_move(&board.line) && wait(&board) && line_move(&board.line);
    }
    tell(&board);
    return 0;
}
