/* The critical program as thesis figure 3-8 writes it: one poll(), a handler for each input, stamps as in figure 3-9. It is
 * what the Python program is measured against, so it does the same work: the same sockets and filters, DSOR reassembly with
 * its CRC, a position in the plane and its plausibility, a heading and speed controller, limits, four frames, one record.
 *
 *     loop BUS LOG
 *
 * BUS as in bus.h. LOG is a state log that delfim.logging.statelog reads; a record is one write(2). */

#define _GNU_SOURCE
#include "bus.h"
#include <fcntl.h>
#include <math.h>
#include <poll.h>

#define RPM_MAX 1200.0
#define RPM_PER_S 800.0
#define MPS_PER_RPM 0.00196
#define SPEED_MPS 1.5
#define WATCHDOG_MS 100
#define MESSAGE_MAX 256

struct assembly { /* a broadcast message of which the header was heard; `stream` begins with the header, as the CRC does */
    uint32_t arb, id;
    int open, next, missing, length;
    uint8_t number, stream[6 + MESSAGE_MAX + 4];
};

struct record {
    int64_t t0, t1, t2, t3, t4, previous_t5;
    struct navigation navigation;
    double north_m, east_m, error_rad;
    float starboard_rpm, port_rpm;
} __attribute__((packed));

static const char HEAD[] =
    "DELFIM STATE 1\n"
    "{\"record_bytes\": 112, \"byte_order\": \"little\", \"boat\": \"C\", \"started_ns\": 0, \"fields\": ["
#define FIELD(name, code) "{\"name\": \"" name "\", \"code\": \"" code "\", \"unit\": \"\", \"description\": \"\"}"
    FIELD("t0", "q") "," FIELD("t1", "q") "," FIELD("t2", "q") "," FIELD("t3", "q") "," FIELD("t4", "q") ","
    FIELD("previous_t5", "q") "," FIELD("utc", "Q") "," FIELD("latitude", "i") "," FIELD("longitude", "i") ","
    FIELD("north_speed", "h") "," FIELD("east_speed", "h") "," FIELD("heading", "H") "," FIELD("yaw_rate", "h") ","
    FIELD("roll", "h") "," FIELD("pitch", "h") "," FIELD("fix", "B") "," FIELD("satellites", "B") "," FIELD("hdop", "B") ","
    FIELD("counter", "B") "," FIELD("north", "d") "," FIELD("east", "d") "," FIELD("error", "d") ","
    FIELD("starboard_rpm", "f") "," FIELD("port_rpm", "f") "]}\n";
_Static_assert(sizeof(struct record) == 112, "the header says so");

/* Whether this frame completes a message, whose data then follows the header in `stream`. The rules are docs/dsor.md's. */
static int assemble(struct assembly *a, const struct frame *f) {
    const uint32_t stream = DSOR(0xFF, 0, 0x7F, 0x7F, 0);
    if ((f->arb ^ a->arb) & stream) return 0;
    int kind = f->arb >> 22 & 3, sequence = f->arb >> 3 & 31;
    if (kind == HEADER && f->length == 6) {
        uint16_t length;
        uint32_t id;
        memcpy(&length, f->data, 2);
        memcpy(&id, f->data + 2, 4);
        if (a->open && !a->next && a->number == sequence && !memcmp(a->stream, f->data, 6)) return 0;
        a->open = id == a->id && length <= MESSAGE_MAX;
        a->next = 0, a->length = length, a->missing = length + 4, a->number = (uint8_t)sequence;
        memcpy(a->stream, f->data, 6);
    } else if (kind == BODY && a->open) {
        int due = a->missing < 8 ? a->missing : 8;
        if (sequence != (a->next & 31) || f->length != due) {
            if (!a->next || sequence != ((a->next - 1) & 31)) a->open = 0; /* else the last frame once more */
            return 0;
        }
        memcpy(a->stream + 6 + 8 * a->next++, f->data, (size_t)due);
        a->missing -= due;
        if (a->missing) return 0;
        a->open = 0;
        return crc32(0, a->stream, 6 + (size_t)a->length + 4) == 0x2144DF1C;
    }
    return 0;
}

static double clamp(double value, double low, double high) { return value < low ? low : value > high ? high : value; }

static double revolutions(double thrust) { return copysign(sqrt(fabs(thrust) * RPM_MAX), thrust); }

/* Navigation to revolutions: the arithmetic of delfim/vehicle/loop.py, control/autopilot.py and limited() in control.py. */
static void control(struct record *r, int64_t t_ns) {
    static double origin_lat, origin_lon, cosine, heading_rpm, speed_rpm, asked_mps, last_north, last_east;
    static int64_t last_ns;
    const struct navigation *n = &r->navigation;
    double latitude = n->latitude * 1e-7 * M_PI / 180, longitude = n->longitude * 1e-7 * M_PI / 180;
    if (!last_ns) origin_lat = latitude, origin_lon = longitude, cosine = cos(latitude), last_ns = t_ns;
    double dt = clamp((double)(t_ns - last_ns) * 1e-9, 0, 1);
    r->north_m = (latitude - origin_lat) * 6.367e6;
    r->east_m = (longitude - origin_lon) * 6.378e6 * cosine;
    if (hypot(r->north_m - last_north, r->east_m - last_east) > 10 + 15 * dt) r->north_m = last_north, r->east_m = last_east;
    last_ns = t_ns, last_north = r->north_m, last_east = r->east_m;

    double heading = n->heading * 1e-4, rate = n->yaw_rate * 1e-4;
    double error = r->error_rad = remainder(M_PI / 2 - heading, 2 * M_PI);
    double surge = n->north * 1e-3 * cos(heading) + n->east * 1e-3 * sin(heading);
    asked_mps = clamp(SPEED_MPS, asked_mps - 0.4 * dt, asked_mps + 0.4 * dt);
    double differential = clamp(clamp(700 * error, -400, 400) - 1000 * rate + heading_rpm, -RPM_MAX, RPM_MAX);
    if (fabs(error) < 0.5) heading_rpm = clamp(heading_rpm + 30 * error * dt, -150, 150);
    double wanted = asked_mps * fmax(cos(error), 0), lag = wanted - surge;
    double common = wanted / MPS_PER_RPM + 150 * lag + speed_rpm;
    common = clamp(common * fabs(common) / RPM_MAX, 0, RPM_MAX - fabs(differential));
    if (fabs(error) < 0.5) speed_rpm = clamp(speed_rpm + 30 * lag * dt, -400, 400);
    static double starboard, port;
    double starboard_wanted = revolutions(common - differential), port_wanted = revolutions(common + differential);
    starboard = clamp(clamp(starboard_wanted, starboard - RPM_PER_S * dt, starboard + RPM_PER_S * dt), -RPM_MAX, RPM_MAX);
    port = clamp(clamp(port_wanted, port - RPM_PER_S * dt, port + RPM_PER_S * dt), -RPM_MAX, RPM_MAX);
    r->starboard_rpm = (float)starboard, r->port_rpm = (float)port;
}

static void propulsion(const struct bus *bus, int fd, const struct record *r, int run) {
    static uint8_t counter;
    counter++;
    for (int side = 0; side < 2; side++) {
        int16_t rpm = (int16_t)lrintf(side ? r->port_rpm : r->starboard_rpm);
        uint8_t command[4] = {(uint8_t)rpm, (uint8_t)(rpm >> 8), (uint8_t)run, counter};
        bus_send(bus, fd, STANDARD(0x040 + side), command, sizeof command);
    }
    for (int side = 0; side < 2; side++) bus_send(bus, fd, STANDARD(0x042 + side), (uint8_t[]){1, counter}, 2);
}

int main(int count, char **words) {
    if (count != 3) return fputs("usage: loop BUS LOG\n", stderr), 2;
    struct bus bus = bus_named(words[1]);
    int log = open(words[2], O_WRONLY | O_CREAT | O_TRUNC | O_APPEND, 0644), out = bus_sender(&bus);
    if (log < 0 || write(log, HEAD, sizeof HEAD - 1) < 0) die(words[2]);
    const uint32_t any = DSOR(0xFF, BODY, 0, 0x7F, 31) & ~IDE; /* header and body frames of a node to whomever */
    struct pollfd inputs[] = {
        {bus_receiver(&bus, DSOR(0, HEADER, NAVIGATION, 0, 0), any), POLLIN, 0},
        {bus_receiver(&bus, DSOR(SYSSTAT_PRIORITY, PLAIN, 0, 0, SYSSTAT_SUBJECT), 0x7Fu << 15), POLLIN, 0},
        {bus_receiver(&bus, DSOR(0, HEADER, GPS, 0, 0), any), POLLIN, 0},
    };
    struct assembly navigation = {.arb = DSOR(NAVIGATION_PRIORITY, HEADER, NAVIGATION, BROADCAST, 0), .id = NAVIGATION_ID};
    struct assembly gps = {.arb = DSOR(SYSSTAT_PRIORITY, HEADER, GPS, BROADCAST, 0), .id = GPS_SYSSTAT_ID};
    struct frame frame;
    struct record r = {0};
    uint8_t health[128][8] = {{0}};
    int64_t controlled_ns = now_ns(CLOCK_MONOTONIC);
    puts("ready");
    fflush(stdout);
    for (;;) {
        int ready = poll(inputs, 3, WATCHDOG_MS);
        if (inputs[0].revents) {
            int complete = 0;
            int64_t t1 = now_ns(CLOCK_REALTIME);
            while (!complete && bus_receive(&bus, inputs[0].fd, &frame)) complete = assemble(&navigation, &frame);
            if (complete && navigation.length == sizeof r.navigation) {
                memcpy(&r.navigation, navigation.stream + 6, sizeof r.navigation);
                r.t0 = frame.t_ns, r.t1 = t1, r.t2 = now_ns(CLOCK_REALTIME);
                control(&r, controlled_ns = now_ns(CLOCK_MONOTONIC));
                r.t3 = now_ns(CLOCK_REALTIME);
                propulsion(&bus, out, &r, 1);
                r.t4 = now_ns(CLOCK_REALTIME);
                if (write(log, &r, sizeof r) < 0) die("log");
                r.previous_t5 = now_ns(CLOCK_REALTIME);
            }
        }
        if (inputs[1].revents)
            while (bus_receive(&bus, inputs[1].fd, &frame)) memcpy(health[frame.arb >> 15 & 0x7F], frame.data, 8);
        if (inputs[2].revents)
            while (bus_receive(&bus, inputs[2].fd, &frame))
                if (assemble(&gps, &frame)) memcpy(health[GPS], gps.stream + 6, 8);
        if (!ready && now_ns(CLOCK_MONOTONIC) - controlled_ns > 1000000000) propulsion(&bus, out, &(struct record){0}, 0);
    }
}
