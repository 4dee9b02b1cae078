/* The other nodes of the boat for the benchmark: navigation at a steady rate, status reports, and other traffic that fills the
 * bus up to a number of frames a second. Every frame has its instant; the frames of one message follow each other after WIRE_US,
 * the time that a frame takes on the wire, or at once where that is 0.
 *
 *     feeder BUS RATE_HZ WARM_S SECONDS FRAMES_PER_S WIRE_US
 *
 * BUS as in bus.h. Prints one line of JSON at the end: what was sent, how late, and the wall-clock bounds of what is to be
 * measured, which begins after WARM_S. */

#define _GNU_SOURCE
#include "bus.h"
#include <errno.h>
#include <sched.h>
#include <sys/prctl.h>

#define STATUS_HZ 12.0 /* two propellers at 5 Hz, two banks at 1 Hz */
#define OTHERS 64      /* identifiers of other traffic */

static struct bus bus;
static int out;
static long sent, unsent;
static int64_t wire_ns;

static void sleep_until(int64_t due_ns) {
    struct timespec until = {due_ns / 1000000000, due_ns % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {}
}

static void say(uint32_t arb, const void *data, uint8_t length) {
    if (bus_send(&bus, out, arb, data, length)) sent++;
    else unsent++;
}

static void say_message(int priority, int source, uint32_t id, const void *data, uint16_t length, int number) {
    uint8_t stream[6 + 64 + 4];
    memcpy(stream, &length, 2);
    memcpy(stream + 2, &id, 4);
    memcpy(stream + 6, data, length);
    uint32_t crc = crc32(0, stream, 6u + length);
    memcpy(stream + 6 + length, &crc, 4);
    int64_t began_ns = now_ns(CLOCK_MONOTONIC);
    say(DSOR(priority, HEADER, source, BROADCAST, number & 31), stream, 6);
    for (int at = 0; at < length + 4; at += 8) {
        int rest = length + 4 - at;
        if (wire_ns) sleep_until(began_ns + (at / 8 + 1) * wire_ns);
        say(DSOR(priority, BODY, source, BROADCAST, at / 8 & 31), stream + 6 + at, (uint8_t)(rest < 8 ? rest : 8));
    }
}

static void say_navigation(long number) {
    long along = number % 2000; /* a boat that goes north, slowly, and back: it never jumps */
    struct navigation n = {
        .utc_ns = (uint64_t)now_ns(CLOCK_REALTIME),
        .latitude = 386925000 + (int32_t)(along < 1000 ? along : 2000 - along),
        .longitude = -92150000,
        .north = 1000,
        .heading = (uint16_t)(15000 + number % 2000),
        .fix = 3,
        .satellites = 10,
        .hdop = 9,
        .counter = (uint8_t)number,
    };
    say_message(NAVIGATION_PRIORITY, NAVIGATION, NAVIGATION_ID, &n, sizeof n, (int)(number & 31));
}

/* The reports of a second, spread over it: layouts of delfim/canproxy/dsor/messages.py, all good. */
static void say_status(long number) {
    static const uint8_t propeller[8] = {0, 0, 0, 0, 10, 0, 30, 0};
    static const uint8_t batteries[8] = {0, 0, 0xC0, 0x12, 20, 0, 180, 25};
    static const uint8_t gps[16] = {0, 0, 3, 10, 9};
    static const uint8_t nodes[12] = {0x10, 0x11, 0x20, 0x10, 0x11, 0x10, 0x11, 0x21, 0x10, 0x11, 0x10, 0x11};
    int node = nodes[number % 12];
    say(DSOR(SYSSTAT_PRIORITY, PLAIN, node, 0, SYSSTAT_SUBJECT), node < 0x20 ? propeller : batteries, 8);
    if (number % 12 == 0) say_message(SYSSTAT_PRIORITY, GPS, GPS_SYSSTAT_ID, gps, sizeof gps, (int)(number / 12 & 31));
}

static void say_other(long number) { say(STANDARD(0x400 + number % OTHERS), &number, sizeof number); }

int main(int count, char **words) {
    if (count != 7) return fputs("usage: feeder BUS RATE_HZ WARM_S SECONDS FRAMES_PER_S WIRE_US\n", stderr), 2;
    double rate_hz = atof(words[2]), warm_s = atof(words[3]), seconds = atof(words[4]);
    double other_hz = atof(words[5]) - 6 * rate_hz - STATUS_HZ - 4;
    wire_ns = atoi(words[6]) * 1000LL;
    bus = bus_named(words[1]);
    out = bus_sender(&bus);
    prctl(PR_SET_TIMERSLACK, 1);
    struct sched_param fifo = {.sched_priority = 10}; /* nodes do not compete for this computer's processors; as far as permitted */
    if (sched_setscheduler(0, SCHED_FIFO, &fifo)) errno = 0;
    long navigations = (long)((warm_s + seconds) * rate_hz + 0.5), warm = (long)(warm_s * rate_hz + 0.5), done = 0;
    long number[3] = {0};
    double period_ns[3] = {1e9 / rate_hz, 1e9 / STATUS_HZ, other_hz > 0 ? 1e9 / other_hz : 1e15};
    void (*const what[3])(long) = {say_navigation, say_status, say_other};
    int64_t start_ns = now_ns(CLOCK_MONOTONIC) + 1000000, begin_ns = 0, late_ns = 0, latest_ns = 0;
    while (done < navigations) {
        int next = 0;
        int64_t due_ns = INT64_MAX;
        for (int i = 0; i < 3; i++) {
            int64_t due = start_ns + (int64_t)((double)(number[i] + (i != 1)) * period_ns[i]); /* reports begin at once */
            if (due < due_ns) due_ns = due, next = i;
        }
        sleep_until(due_ns);
        if (next == 0) {
            if (done == warm) begin_ns = now_ns(CLOCK_REALTIME);
            int64_t late = now_ns(CLOCK_MONOTONIC) - due_ns;
            late_ns += late;
            if (late > latest_ns) latest_ns = late;
            done++;
        }
        what[next](number[next]++);
    }
    printf("{\"messages\": %ld, \"frames\": %ld, \"unsent\": %ld, \"late_us_mean\": %.1f, \"late_us_max\": %.1f, "
           "\"begin_ns\": %lld, \"end_ns\": %lld}\n",
           done, sent, unsent, done ? (double)late_ns / (double)done / 1e3 : 0.0, (double)latest_ns / 1e3, (long long)begin_ns,
           (long long)now_ns(CLOCK_REALTIME));
    return 0;
}
