/*
 * A load generator: load PORT CONNECTIONS IN_FLIGHT SECONDS [PID]
 *
 * Reads ten holding registers on every connection, IN_FLIGHT requests at a time on
 * each (a power of two, 1..256), for SECONDS, or longer until there are as many answers
 * as connections. It checks of every answer the transaction id, the length and the
 * values: register N must hold N. Every connection gets one answer before the time
 * begins.
 *
 * Prints one line of JSON: connections that answered; requests answered in time and
 * the seconds they took; errors (wrong answers and lost connections) and what the first
 * was; missing (requests that were never answered); microseconds from request to answer
 * (p50, p99, max); seconds of processor time of this program, and of the server if its
 * PID is given.
 */

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define COUNT 10                     /* registers of a request */
#define ADDRESSES 990                /* where they begin: 0, 10, ... */
#define REQUEST 12                   /* bytes */
#define ANSWER (9 + 2 * COUNT)       /* bytes */
#define MAX_IN_FLIGHT 256
#define MAX_EVENTS 1024
#define CONNECT_WITHIN 10            /* seconds, for all connections and their first answers */
#define LAST_WITHIN 5                /* seconds, for the last answers ... */
#define STALLED 0.5                  /* ... unless none comes for so long */
#define FIGURES 64                   /* steps of the histogram in each power of two */

struct slot {
    double sent; /* 0: free */
    uint16_t transaction;
    uint16_t address;
};

struct connection {
    int descriptor; /* -1: lost */
    int in_flight;
    unsigned length;
    struct slot *slots;
    uint8_t received[MAX_IN_FLIGHT * ANSWER];
};

static struct connection *connections;
static int connection_count, in_flight, epoll;
static bool is_measuring; /* answers count */
static bool is_asking;    /* answers are followed by the next request */
static unsigned long answered, errors, lost, histogram[64 * FIGURES];
static double longest, last_answer;
static const char *first_error = "";

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + (double)time.tv_nsec / 1e9;
}

static void note_error(const char *what)
{
    if (errors++ == 0)
        first_error = what;
}

static void lose(struct connection *connection, const char *why)
{
    note_error(why);
    close(connection->descriptor);
    connection->descriptor = -1;
    lost += (unsigned long)connection->in_flight;
    connection->in_flight = 0;
}

/* --- latency, to two per cent ------------------------------------------------------ */

static unsigned bucket(uint64_t nanoseconds)
{
    unsigned power = 0;
    for (; nanoseconds >= 2 * FIGURES; nanoseconds /= 2)
        power++;
    return power * FIGURES + (unsigned)nanoseconds;
}

static double bucket_start(unsigned index)
{
    unsigned power = index < 2 * FIGURES ? 0 : index / FIGURES - 1;
    return (double)(index - power * FIGURES) * (double)(1ull << power);
}

static double percentile(double fraction)
{
    unsigned long seen = 0;
    for (unsigned index = 0; index < 64 * FIGURES; index++) {
        seen += histogram[index];
        if (seen > 0 && (double)seen >= fraction * (double)answered)
            return bucket_start(index) / 1e3;
    }
    return 0;
}

/* --- requests and answers ---------------------------------------------------------- */

static void put16(uint8_t *bytes, unsigned value)
{
    bytes[0] = (uint8_t)(value >> 8);
    bytes[1] = (uint8_t)value;
}

static unsigned get16(const uint8_t *bytes)
{
    return (unsigned)bytes[0] << 8 | bytes[1];
}

static void write_request(uint8_t *bytes, struct slot *slot, double time)
{
    /* The transaction id names the slot: answers may come in any order. */
    slot->transaction = (uint16_t)(slot->transaction + in_flight);
    slot->address = (uint16_t)((slot->address + COUNT) % ADDRESSES);
    slot->sent = time;
    put16(bytes, slot->transaction);
    put16(bytes + 2, 0);
    put16(bytes + 4, REQUEST - 6);
    bytes[6] = 1;
    bytes[7] = 3;
    put16(bytes + 8, slot->address);
    put16(bytes + 10, COUNT);
}

/* Fills the first `most` places in flight. */
static void ask(struct connection *connection, int most, double time)
{
    uint8_t bytes[MAX_IN_FLIGHT * REQUEST];
    size_t length = 0;
    for (int index = 0; index < most; index++) {
        if (connection->slots[index].sent == 0) {
            write_request(bytes + length, &connection->slots[index], time);
            length += REQUEST;
            connection->in_flight++;
        }
    }
    ssize_t sent = send(connection->descriptor, bytes, length, MSG_NOSIGNAL);
    if (sent != (ssize_t)length)
        lose(connection, "cannot send");
}

static const char *fault_of(const uint8_t *bytes, const struct slot *slot)
{
    if (slot->sent == 0 || get16(bytes) != slot->transaction)
        return "wrong transaction id";
    if (bytes[7] != 3 || bytes[8] != 2 * COUNT)
        return "wrong function or byte count";
    for (unsigned index = 0; index < COUNT; index++)
        if (get16(bytes + 9 + 2 * index) != slot->address + index)
            return "wrong values";
    return NULL;
}

static void count_answer(double seconds)
{
    if (!is_measuring)
        return;
    answered++;
    histogram[bucket((uint64_t)(seconds * 1e9))]++;
    if (seconds > longest)
        longest = seconds;
}

/* Gives the bytes taken, 0 for an incomplete answer, -1 for what is none. */
static int take(struct connection *connection, const uint8_t *bytes, unsigned length, double time)
{
    if (length < 9)
        return 0;
    unsigned size = 6 + get16(bytes + 4);
    if (get16(bytes + 2) != 0 || size > ANSWER) {
        lose(connection, "wrong header");
        return -1;
    }
    if (length < size)
        return 0;
    struct slot *slot = &connection->slots[get16(bytes) % (unsigned)in_flight];
    const char *fault = size == ANSWER ? fault_of(bytes, slot) : "an exception, or too short";
    if (fault != NULL)
        note_error(fault);
    else
        count_answer(time - slot->sent);
    if (slot->sent != 0) {
        slot->sent = 0;
        connection->in_flight--;
        last_answer = time;
    }
    return (int)size;
}

/*
 * At once: a server that leaves Nagle's algorithm on keeps its next answer back until
 * then. A request that follows does it as well.
 */
static void acknowledge(struct connection *connection)
{
    int on = 1;
    setsockopt(connection->descriptor, IPPROTO_TCP, TCP_QUICKACK, &on, sizeof on);
}

static void receive(struct connection *connection)
{
    ssize_t got = recv(connection->descriptor, connection->received + connection->length,
                       sizeof connection->received - connection->length, 0);
    if (got <= 0) {
        if (got == 0 || (errno != EAGAIN && errno != EINTR))
            lose(connection, got == 0 ? "closed by the server" : strerror(errno));
        return;
    }
    double time = now();
    unsigned start = 0;
    int taken;
    connection->length += (unsigned)got;
    while ((taken = take(connection, connection->received + start, connection->length - start,
                         time)) > 0)
        start += (unsigned)taken;
    if (taken == -1)
        return;
    connection->length -= start;
    memmove(connection->received, connection->received + start, connection->length);
    if (is_asking && start > 0)
        ask(connection, in_flight, time);
    else
        acknowledge(connection);
}

/* --- the run ----------------------------------------------------------------------- */

static bool connect_one(struct connection *connection, struct sockaddr_in *server, double left)
{
    int on = 1;
    struct timeval timeout = {(time_t)left, 1};
    int descriptor = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    connection->descriptor = descriptor;
    if (descriptor == -1)
        return false;
    setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    setsockopt(descriptor, SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof timeout);
    if (left <= 0 || connect(descriptor, (struct sockaddr *)server, sizeof *server) == -1)
        return false;
    fcntl(descriptor, F_SETFL, O_NONBLOCK);
    struct epoll_event event = {EPOLLIN, {.ptr = connection}};
    return epoll_ctl(epoll, EPOLL_CTL_ADD, descriptor, &event) == 0;
}

static void turn(double left)
{
    struct epoll_event events[MAX_EVENTS];
    int ready = epoll_wait(epoll, events, MAX_EVENTS, left > 0 ? (int)(left * 1e3) + 1 : 0);
    for (int index = 0; index < ready; index++) {
        struct connection *connection = events[index].data.ptr;
        if (connection->descriptor != -1)
            receive(connection);
    }
}

/* The first request and its answer. */
static void exchange(struct connection *connection, double end)
{
    double left;
    ask(connection, 1, now());
    while (connection->in_flight > 0 && (left = end - now()) > 0)
        turn(left);
    if (connection->in_flight > 0)
        lose(connection, "no first answer");
}

/*
 * One after the other: a crowd at the door would measure the length of the queue before
 * it, and in some servers that is five.
 */
static void connect_all(int port)
{
    struct sockaddr_in server = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    server.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    double end = now() + CONNECT_WITHIN;
    for (int index = 0; index < connection_count; index++) {
        struct connection *connection = &connections[index];
        connection->slots = calloc((size_t)in_flight, sizeof *connection->slots);
        for (int number = 0; number < in_flight; number++) {
            connection->slots[number].transaction = (uint16_t)number;
            connection->slots[number].address = (uint16_t)((index + number) * COUNT % ADDRESSES);
        }
        if (!connect_one(connection, &server, end - now()))
            lose(connection, strerror(errno));
        else
            exchange(connection, end);
    }
}

static int count_connected(void)
{
    int sum = 0;
    for (int index = 0; index < connection_count; index++)
        sum += connections[index].descriptor != -1;
    return sum;
}

static void ask_all(void)
{
    for (int index = 0; index < connection_count; index++)
        if (connections[index].descriptor != -1)
            ask(&connections[index], in_flight, now());
}

static unsigned long outstanding(void)
{
    unsigned long sum = 0;
    for (int index = 0; index < connection_count; index++)
        sum += (unsigned long)connections[index].in_flight;
    return sum;
}

/* For so long, and until there is something to tell. */
static void run_for(double seconds)
{
    double end = now() + seconds, last = end + LAST_WITHIN, time;
    while ((time = now()) < end)
        turn(end - time);
    while (errors == 0 && answered < (unsigned long)connection_count && outstanding() > 0 &&
           (time = now()) < last)
        turn(last - time);
}

static void drain(double seconds, double stalled)
{
    double end = now() + seconds, time;
    last_answer = now();
    while (outstanding() > 0 && (time = now()) < end && time < last_answer + stalled)
        turn(stalled);
}

/* --- processor time ---------------------------------------------------------------- */

static double own_time(void)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return (double)(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
           (double)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
}

/* Of all threads. */
static double time_of(pid_t process)
{
    clockid_t clock;
    struct timespec time;
    if (process == 0 || clock_getcpuclockid(process, &clock) != 0 ||
        clock_gettime(clock, &time) == -1)
        return 0;
    return (double)time.tv_sec + (double)time.tv_nsec / 1e9;
}

int main(int argc, char **argv)
{
    if (argc != 5 && argc != 6) {
        fprintf(stderr, "usage: load PORT CONNECTIONS IN_FLIGHT SECONDS [PID]\n");
        return 2;
    }
    pid_t server = argc == 6 ? atoi(argv[5]) : 0;
    connection_count = atoi(argv[2]);
    in_flight = atoi(argv[3]);
    if (connection_count < 1 || in_flight < 1 || in_flight > MAX_IN_FLIGHT ||
        (in_flight & (in_flight - 1)) != 0) {
        fprintf(stderr, "load: CONNECTIONS from 1, IN_FLIGHT a power of two, 1..256\n");
        return 2;
    }
    struct rlimit limit;
    getrlimit(RLIMIT_NOFILE, &limit);
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
    epoll = epoll_create1(EPOLL_CLOEXEC);
    connections = calloc((size_t)connection_count, sizeof *connections);
    if (epoll == -1 || connections == NULL) {
        perror("load");
        return 1;
    }

    connect_all(atoi(argv[1]));
    int ready = count_connected();
    lost = 0;

    is_measuring = is_asking = true;
    double server_start = time_of(server), own_start = own_time(), start = now();
    ask_all();
    run_for(atof(argv[4]));
    double seconds = now() - start, own = own_time() - own_start;
    double server_time = time_of(server) - server_start;
    is_measuring = is_asking = false;
    drain(LAST_WITHIN, STALLED);

    printf("{\"connections\": %d, \"requests\": %lu, \"seconds\": %.6f, \"errors\": %lu, "
           "\"first_error\": \"%s\", \"missing\": %lu, \"p50\": %.1f, \"p99\": %.1f, "
           "\"max\": %.1f, \"load_cpu\": %.6f, \"server_cpu\": %.6f}\n",
           ready, answered, seconds, errors, first_error, lost + outstanding(), percentile(0.50),
           percentile(0.99), longest * 1e6, own, server_time);
    return 0;
}
