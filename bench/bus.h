/* What loop.c and feeder.c share: a CAN bus, Linux' own or canloop's (delfim/canproxy/canloop.py), and the layouts of the
 * boat's messages (docs/dsor.md, delfim/canproxy/dsor/messages.py). A bus is named as an interface, "can0", or as canloop's multicast
 * group, "239.255.1.2:17000". Arbitration fields are those of thesis figure 5-5. */

#include <arpa/inet.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <linux/filter.h>
#include <net/if.h>
#include <netinet/in.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define IDE 4u
#define STANDARD(id) ((uint32_t)(id) << 21)
#define DSOR(priority, kind, source, destination, sequence)                                                              \
    ((uint32_t)(priority) << 24 | (uint32_t)(kind) << 22 | (uint32_t)(source) << 15 | (uint32_t)(destination) << 8 |     \
     (uint32_t)(sequence) << 3 | IDE)

enum { HEADER, BODY, ACK, PLAIN };
enum { VEHICLE = 0x00, GPS = 0x01, NAVIGATION = 0x02, BROADCAST = 0x7F, SYSSTAT_SUBJECT = 1 };
enum { NAVIGATION_PRIORITY = 0x20, SYSSTAT_PRIORITY = 0x80, NAVIGATION_ID = 1, GPS_SYSSTAT_ID = 2 };

struct navigation { /* little endian, as delfim.canproxy.dsor.messages.NAVIGATION */
    uint64_t utc_ns;
    int32_t latitude, longitude; /* 1e-7 degrees */
    int16_t north, east;         /* mm/s */
    uint16_t heading;            /* 1e-4 rad */
    int16_t yaw_rate, roll, pitch;
    uint8_t fix, satellites, hdop, counter;
} __attribute__((packed));

struct frame {
    uint32_t arb;
    uint8_t length, data[8];
    int64_t t_ns; /* the kernel's stamp */
};

struct bus {
    struct sockaddr_in group; /* of canloop; port 0 on Linux' own CAN */
    struct sockaddr_can can;
};

struct datagram { /* of canloop, network byte order */
    uint32_t count, arb;
    uint8_t length, data[8];
} __attribute__((packed));

static inline void die(const char *what) {
    perror(what);
    exit(1);
}

static inline int64_t now_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

/* CRC-32 of zlib: pass 0 first, then what the call before returned. */
static inline uint32_t crc32(uint32_t crc, const uint8_t *data, size_t length) {
    static uint32_t table[256];
    if (!table[1])
        for (uint32_t i = 0; i < 256; i++) {
            uint32_t c = i;
            for (int bit = 0; bit < 8; bit++) c = c & 1 ? c >> 1 ^ 0xEDB88320u : c >> 1;
            table[i] = c;
        }
    crc = ~crc;
    while (length--) crc = table[(crc ^ *data++) & 0xFF] ^ crc >> 8;
    return ~crc;
}

static inline struct bus bus_named(const char *name) {
    struct bus bus = {0};
    const char *colon = strchr(name, ':');
    if (colon) {
        char address[32] = {0};
        strncat(address, name, (size_t)(colon - name) < 31 ? (size_t)(colon - name) : 31);
        bus.group = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(colon + 1))};
        if (!inet_aton(address, &bus.group.sin_addr)) die(name);
    } else {
        bus.can = (struct sockaddr_can){.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(name)};
        if (!bus.can.can_ifindex) die(name);
    }
    return bus;
}

/* A socket that receives the extended frames that equal arb where mask has no bit, stamped by the kernel. */
static inline int bus_receiver(const struct bus *bus, uint32_t arb, uint32_t mask) {
    int loop = bus->group.sin_port != 0, on = 1, off = 0, size = 1 << 20;
    int fd = loop ? socket(AF_INET, SOCK_DGRAM, 0) : socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (fd < 0) die("socket");
    if (setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof size)) setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    if (setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on)) die("SO_TIMESTAMPNS");
    if (loop) {
        struct sock_filter rows[] = {{BPF_LD | BPF_W | BPF_ABS, 0, 0, 8 + 4}, /* 8: the UDP header comes first */
                                     {BPF_ALU | BPF_AND | BPF_K, 0, 0, ~mask},
                                     {BPF_JMP | BPF_JEQ | BPF_K, 0, 1, arb & ~mask},
                                     {BPF_RET | BPF_K, 0, 0, 0xFFFFFFFF},
                                     {BPF_RET | BPF_K, 0, 0, 0}};
        struct sock_fprog program = {sizeof rows / sizeof *rows, rows};
        struct ip_mreq member = {bus->group.sin_addr, {htonl(INADDR_LOOPBACK)}};
        if (setsockopt(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof program)) die("SO_ATTACH_FILTER");
        if (setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on)) die("SO_REUSEADDR");
        if (setsockopt(fd, IPPROTO_IP, IP_MULTICAST_ALL, &off, sizeof off)) die("IP_MULTICAST_ALL");
        if (bind(fd, (const struct sockaddr *)&bus->group, sizeof bus->group)) die("bind");
        if (setsockopt(fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &member, sizeof member)) die("IP_ADD_MEMBERSHIP");
    } else {
        struct can_filter filter = {arb >> 3 | CAN_EFF_FLAG, (~mask >> 3 & CAN_EFF_MASK) | CAN_EFF_FLAG | CAN_RTR_FLAG};
        if (setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, &filter, sizeof filter)) die("CAN_RAW_FILTER");
        if (bind(fd, (const struct sockaddr *)&bus->can, sizeof bus->can)) die("bind");
    }
    return fd;
}

/* The next queued frame; 0 when there is none. */
static inline int bus_receive(const struct bus *bus, int fd, struct frame *frame) {
    union {
        struct datagram loop;
        struct can_frame can;
    } raw;
    char control[CMSG_SPACE(sizeof(struct timespec))];
    struct iovec part = {&raw, sizeof raw};
    struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = control, .msg_controllen = sizeof control};
    ssize_t length = recvmsg(fd, &message, MSG_DONTWAIT);
    if (length < (ssize_t)(bus->group.sin_port ? sizeof raw.loop : sizeof raw.can)) return 0;
    const struct cmsghdr *header = CMSG_FIRSTHDR(&message);
    struct timespec stamp = {0};
    if (header) memcpy(&stamp, CMSG_DATA(header), sizeof stamp);
    frame->t_ns = stamp.tv_sec * 1000000000LL + stamp.tv_nsec;
    if (bus->group.sin_port) {
        frame->arb = ntohl(raw.loop.arb);
        frame->length = raw.loop.length;
        memcpy(frame->data, raw.loop.data, 8);
    } else {
        frame->arb = (raw.can.can_id & CAN_EFF_MASK) << 3 | IDE; /* the filter lets nothing else through */
        frame->length = raw.can.len;
        memcpy(frame->data, raw.can.data, 8);
    }
    if (frame->length > 8) frame->length = 8;
    return 1;
}

static inline int bus_sender(const struct bus *bus) {
    if (!bus->group.sin_port) {
        int fd = socket(PF_CAN, SOCK_RAW, CAN_RAW);
        if (fd < 0 || setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, NULL, 0)) die("socket");
        if (bind(fd, (const struct sockaddr *)&bus->can, sizeof bus->can)) die("bind");
        return fd;
    }
    struct in_addr loopback = {htonl(INADDR_LOOPBACK)};
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr = loopback};
    int fd = socket(AF_INET, SOCK_DGRAM, 0);
    if (fd < 0 || bind(fd, (const struct sockaddr *)&here, sizeof here)) die("socket");
    if (setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback)) die("IP_MULTICAST_IF");
    if (connect(fd, (const struct sockaddr *)&bus->group, sizeof bus->group)) die("connect");
    return fd;
}

/* Send a frame without waiting; 0 when the bus does not take it. */
static inline int bus_send(const struct bus *bus, int fd, uint32_t arb, const void *data, uint8_t length) {
    static struct {
        uint32_t arb, count;
    } numbering[1024]; /* canloop numbers the frames of each arbitration field */
    if (!bus->group.sin_port) {
        struct can_frame raw = {.can_id = arb & IDE ? arb >> 3 | CAN_EFF_FLAG : arb >> 21, .len = length};
        memcpy(raw.data, data, length);
        return send(fd, &raw, sizeof raw, MSG_DONTWAIT) == sizeof raw;
    }
    uint32_t at = arb * 2654435769u >> 22;
    while (numbering[at].arb && numbering[at].arb != arb) at = (at + 1) & 1023;
    numbering[at].arb = arb;
    struct datagram raw = {htonl(numbering[at].count), htonl(arb), length, {0}};
    memcpy(raw.data, data, length);
    if (send(fd, &raw, sizeof raw, MSG_DONTWAIT) != sizeof raw) return 0;
    numbering[at].count++;
    return 1;
}
