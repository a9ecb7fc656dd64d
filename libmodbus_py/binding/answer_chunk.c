/* Answer all requests of Modbus/TCP that were received together, in one call from Python: split the
 * data, check each request, call modbus_reply, collect the answers.
 *
 * Some requests are left to the caller: functions that libmodbus does not have, requests that hooks
 * or handlers need to see, frames of other protocols, and invalid headers. */

#include <errno.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>

#include <modbus/modbus.h>

enum { HEADER_SIZE = 7, EXCEPTION_SIZE = 9, OUTCOMES = 32 };

/* A socketpair never fills up with so many of the longest answers; it has room for 167
 * (measured with 3.1.6). */
enum { UNREAD_MAX = 64 };

/* The requests of one device since the tally was last read. */
typedef struct {
    uint32_t requests;
    uint32_t refused;
    uint8_t was_refused[OUTCOMES]; /* the latest requests; n is at n % OUTCOMES */
} tally_t;

/* The tables, in the order of `ranges`. */
enum { COILS, DISCRETE_INPUTS, HOLDING_REGISTERS, INPUT_REGISTERS, TABLES };

/* The addresses of a table, ascending: the first and the last of each run. No runs are adjacent. */
typedef struct {
    int count; /* of runs */
    const uint16_t *edges;
} runs_t;

typedef struct {
    modbus_mapping_t tables; /* from the first address to the last, holes included */
    runs_t ranges[TABLES];   /* the addresses that exist; all of them have memory in `tables` */
} mapping_t;

/* The requests that hooks and handlers of a device need to see. */
typedef struct {
    uint32_t functions;                   /* bit n: function n may be answered in C, */
    runs_t reads[TABLES], writes[TABLES]; /* unless it reads or writes one of these */
} watched_t;

/* modbus_reply writes into the socket of the context; `outlet` is its other end. */
typedef struct {
    modbus_t *context;
    int outlet;
    uint8_t *answers;
    int room;        /* of `answers`, at least MODBUS_TCP_MAX_ADU_LENGTH */
    int size;        /* of the answers to the last chunk */
    int requests;    /* in the last chunk, */
    int refused;     /* and how many of them got an exception */
    int unread;      /* answers that wait in the outlet, */
    int unread_size; /* and their bytes */
} replier_t;

static int word(const uint8_t *at)
{
    return at[0] << 8 | at[1];
}

static int is_read(const uint8_t *pdu, int size, int limit)
{
    return size == 5 && word(pdu + 3) >= 1 && word(pdu + 3) <= limit;
}

static int is_write(const uint8_t *pdu, int size, int limit, int bits)
{
    int count, bytes;
    if (size < 6)
        return 0;
    count = word(pdu + 3);
    bytes = (count * bits + 7) / 8;
    return count >= 1 && count <= limit && pdu[5] == bytes && size == 6 + bytes;
}

static int is_write_and_read(const uint8_t *pdu, int size)
{
    int reads, writes;
    if (size < 10)
        return 0;
    reads = word(pdu + 3);
    writes = word(pdu + 7);
    return reads >= 1 && reads <= MODBUS_MAX_WR_READ_REGISTERS && writes >= 1 &&
           writes <= MODBUS_MAX_WR_WRITE_REGISTERS && pdu[9] == 2 * writes &&
           size == 10 + 2 * writes;
}

/* Length, quantities and constants: Application Protocol V1.1b3, 6.1-6.6, 6.11, 6.12,
 * 6.16, 6.17. modbus_reply (3.1.6) checks few of them, and sleeps when a check fails.
 * Returns 1 for a good request, 0 for an illegal data value, -1 for a function that is not
 * in libmodbus. */
static int judge(const uint8_t *pdu, int size)
{
    switch (pdu[0]) {
    case MODBUS_FC_READ_COILS:
    case MODBUS_FC_READ_DISCRETE_INPUTS:
        return is_read(pdu, size, MODBUS_MAX_READ_BITS);
    case MODBUS_FC_READ_HOLDING_REGISTERS:
    case MODBUS_FC_READ_INPUT_REGISTERS:
        return is_read(pdu, size, MODBUS_MAX_READ_REGISTERS);
    case MODBUS_FC_WRITE_SINGLE_COIL:
        return size == 5 && (word(pdu + 3) == 0x0000 || word(pdu + 3) == 0xFF00);
    case MODBUS_FC_WRITE_SINGLE_REGISTER:
        return size == 5;
    case MODBUS_FC_WRITE_MULTIPLE_COILS:
        return is_write(pdu, size, MODBUS_MAX_WRITE_BITS, 1);
    case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
        return is_write(pdu, size, MODBUS_MAX_WRITE_REGISTERS, 16);
    case MODBUS_FC_MASK_WRITE_REGISTER:
        return size == 7;
    case MODBUS_FC_WRITE_AND_READ_REGISTERS:
        return is_write_and_read(pdu, size);
    default:
        return -1;
    }
}

/* A run of items that a request reads or writes. */
typedef struct {
    int table;
    int is_write;
    int first;
    int count;
} span_t;

/* Function code -> the span after it: address and count, or the address of a single item. */
static const struct {
    uint8_t table, is_write, is_single;
} SPANS[] = {
    [MODBUS_FC_READ_COILS] = {COILS, 0, 0},
    [MODBUS_FC_READ_DISCRETE_INPUTS] = {DISCRETE_INPUTS, 0, 0},
    [MODBUS_FC_READ_HOLDING_REGISTERS] = {HOLDING_REGISTERS, 0, 0},
    [MODBUS_FC_READ_INPUT_REGISTERS] = {INPUT_REGISTERS, 0, 0},
    [MODBUS_FC_WRITE_SINGLE_COIL] = {COILS, 1, 1},
    [MODBUS_FC_WRITE_SINGLE_REGISTER] = {HOLDING_REGISTERS, 1, 1},
    [MODBUS_FC_WRITE_MULTIPLE_COILS] = {COILS, 1, 0},
    [MODBUS_FC_WRITE_MULTIPLE_REGISTERS] = {HOLDING_REGISTERS, 1, 0},
    [MODBUS_FC_MASK_WRITE_REGISTER] = {HOLDING_REGISTERS, 1, 1},
    [MODBUS_FC_WRITE_AND_READ_REGISTERS] = {HOLDING_REGISTERS, 0, 0}, /* and another */
};

enum { SPANS_MAX = 2 };

/* Find the spans of a good request; returns their number. */
static int find_spans(const uint8_t *pdu, span_t *spans)
{
    int function = pdu[0];
    spans[0].table = SPANS[function].table;
    spans[0].is_write = SPANS[function].is_write;
    spans[0].first = word(pdu + 1);
    spans[0].count = SPANS[function].is_single ? 1 : word(pdu + 3);
    if (function != MODBUS_FC_WRITE_AND_READ_REGISTERS)
        return 1;
    spans[1] = (span_t){HOLDING_REGISTERS, 1, word(pdu + 5), word(pdu + 7)};
    return 2;
}

/* Returns the first run that does not end before an address. */
static int run_from(const runs_t *runs, int address)
{
    int low = 0, high = runs->count;
    while (low < high) {
        int middle = (low + high) / 2;
        if (runs->edges[2 * middle + 1] < address)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static int has(const runs_t *runs, int first, int count)
{
    int run = run_from(runs, first);
    return run < runs->count && runs->edges[2 * run] <= first &&
           first + count - 1 <= runs->edges[2 * run + 1];
}

/* Returns 1 if all addresses exist. modbus_reply does not check it well: 3.1.6 as released writes
 * before the table of function 23 (CVE-2022-0367), and no version knows tables with holes. */
static int exists(const mapping_t *mapping, const span_t *spans, int count)
{
    for (int at = 0; at < count; at++)
        if (!has(&mapping->ranges[spans[at].table], spans[at].first, spans[at].count))
            return 0;
    return 1;
}

/* Returns 1 if a hook needs to see the request. */
static int is_watched(const watched_t *watched, const span_t *spans, int count)
{
    for (int at = 0; at < count; at++) {
        const span_t *span = &spans[at];
        const runs_t *runs = &(span->is_write ? watched->writes : watched->reads)[span->table];
        int run = run_from(runs, span->first);
        if (run < runs->count && runs->edges[2 * run] < span->first + span->count)
            return 1;
    }
    return 0;
}

/* Append the answers that wait in the outlet to `answers`. */
static int gather(replier_t *replier)
{
    while (replier->unread_size > 0) {
        ssize_t got = recv(replier->outlet, replier->answers + replier->size,
                           (size_t)replier->unread_size, MSG_DONTWAIT);
        if (got <= 0)
            return -1;
        replier->size += (int)got;
        replier->unread_size -= (int)got;
    }
    replier->unread = 0;
    return 0;
}

static int refuse(replier_t *replier, const uint8_t *request, uint8_t code)
{
    uint8_t *answer;
    if (gather(replier) == -1)
        return -1;
    answer = replier->answers + replier->size;
    memcpy(answer, request, HEADER_SIZE);
    answer[4] = 0;
    answer[5] = EXCEPTION_SIZE - 6;
    answer[7] = request[7] | 0x80;
    answer[8] = code;
    replier->size += EXCEPTION_SIZE;
    return EXCEPTION_SIZE;
}

static int reply(replier_t *replier, const uint8_t *request, int size, modbus_mapping_t *mapping)
{
    int sent = modbus_reply(replier->context, request, size, mapping);
    if (sent == -1)
        return -1;
    replier->unread_size += sent;
    if (++replier->unread == UNREAD_MAX && gather(replier) == -1)
        return -1;
    return sent;
}

static void note(replier_t *replier, tally_t *tally, int refused)
{
    tally->was_refused[tally->requests++ % OUTCOMES] = (uint8_t)refused;
    tally->refused += (uint32_t)refused;
    replier->requests++;
    replier->refused += refused;
}

static int has_room(const replier_t *replier)
{
    return replier->room - replier->size - replier->unread_size >= MODBUS_TCP_MAX_ADU_LENGTH;
}

/* Answer the requests from data[start] on, while they are for this device and there is room for
 * answers.
 *
 * watched: further requests that are left to the caller; unit: the unit of the device.
 * Returns the index of the first byte that was not used, always after a whole frame; or -1 if the
 * replier failed (errno); then its outlet cannot be used any more. */
static int answer_chunk(replier_t *replier, mapping_t *mapping, const watched_t *watched,
                        tally_t *tally, int unit, const uint8_t *data, int start, int end)
{
    replier->size = replier->requests = replier->refused = 0;
    while (end - start > HEADER_SIZE && has_room(replier)) {
        const uint8_t *frame = data + start;
        int length = word(frame + 4);
        int size = 6 + length;
        span_t spans[SPANS_MAX];
        int verdict, touched, sent;
        if (word(frame + 2) != 0 || length < 2 || size > MODBUS_TCP_MAX_ADU_LENGTH ||
            size > end - start || frame[6] != unit)
            break;
        verdict = judge(frame + HEADER_SIZE, size - HEADER_SIZE);
        if (verdict == -1 || !(watched->functions >> frame[HEADER_SIZE] & 1))
            break;
        touched = verdict == 0 ? 0 : find_spans(frame + HEADER_SIZE, spans);
        if (verdict == 0)
            sent = refuse(replier, frame, MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE);
        else if (!exists(mapping, spans, touched))
            sent = refuse(replier, frame, MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS);
        else if (is_watched(watched, spans, touched))
            break;
        else
            sent = reply(replier, frame, size, &mapping->tables);
        if (sent == -1)
            return -1;
        /* Only an exception is so short: other answers have at least a byte count and a byte. */
        note(replier, tally, sent == EXCEPTION_SIZE);
        start += size;
    }
    return gather(replier) == -1 ? -1 : start;
}
