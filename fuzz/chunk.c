/* libFuzzer on the C helper of the server: chunks of Modbus/TCP, whatever is in them.
 *
 * Two bytes of an input say for which unit the device is and how much room there
 * is for answers, and whether there are hooks; the rest is the chunk. It lies in memory of its exact size, as the
 * answers do, so that AddressSanitizer sees every byte read or written beside them.
 * What is answered is compared with what was asked, frame by frame. */

#include <stdio.h>
#include <stdlib.h>

#include "../libmodbus_py/binding/answer_chunk.c"

#define CHECK(truth)                                                      \
    do {                                                                  \
        if (!(truth)) {                                                   \
            fprintf(stderr, "chunk.c:%d: not so: %s\n", __LINE__, #truth); \
            abort();                                                      \
        }                                                                 \
    } while (0)

static replier_t replier;
static mapping_t mapping;

static const uint16_t coils[] = {10, 999, 1003, 2109};
static const uint16_t registers[] = {100, 100, 102, 199, 210, 399};
static const uint16_t discrete_inputs[] = {20, 2119}, input_registers[] = {200, 399};

/* Hooks want reads of these coils and writes of these registers; a handler has function 4. */
static const uint16_t read_coils[] = {50, 60, 90, 90}, written_registers[] = {150, 159};
static const watched_t nothing = {.functions = 0xFFFFFFFF};
static const watched_t something = {
    .functions = 0xFFFFFFFF ^ 1 << 4,
    .reads[COILS] = {2, read_coils},
    .writes[HOLDING_REGISTERS] = {1, written_registers},
};

static void set_up(void)
{
    int pair[2];
    modbus_mapping_t *made;
    CHECK(socketpair(AF_UNIX, SOCK_STREAM, 0, pair) == 0);
    replier.context = modbus_new_tcp("127.0.0.1", 0);
    CHECK(replier.context != NULL);
    CHECK(modbus_set_socket(replier.context, pair[0]) == 0);
    CHECK(modbus_set_response_timeout(replier.context, 0, 1) == 0);
    replier.outlet = pair[1];
    made = modbus_mapping_new_start_address(10, 2100, 20, 2100, 100, 300, 200, 200);
    CHECK(made != NULL);
    mapping.tables = *made;
    free(made);
    mapping.ranges[COILS] = (runs_t){2, coils};
    mapping.ranges[DISCRETE_INPUTS] = (runs_t){1, discrete_inputs};
    mapping.ranges[HOLDING_REGISTERS] = (runs_t){3, registers};
    mapping.ranges[INPUT_REGISTERS] = (runs_t){1, input_registers};
}

static void empty_tables(void)
{
    memset(mapping.tables.tab_bits, 0, (size_t)mapping.tables.nb_bits);
    memset(mapping.tables.tab_registers, 0, 2 * (size_t)mapping.tables.nb_registers);
}

static int is_whole(const uint8_t *data, int size)
{
    return size >= 8 && word(data + 2) == 0 && word(data + 4) >= 2 && word(data + 4) <= 254 &&
           size >= 6 + word(data + 4);
}

static int is_known(uint8_t function)
{
    return memchr("\1\2\3\4\5\6\17\20\26\27", function, 10) != NULL;
}

/* An answer to this request, of the one length that it can have. */
static void check_answer(const uint8_t *request, const uint8_t *answer, int size)
{
    const uint8_t *asked = request + 7, *got = answer + 7;
    CHECK(memcmp(request, answer, 4) == 0 && request[6] == answer[6]);
    if (got[0] == (asked[0] | 0x80)) {
        CHECK(size == 9 && (got[1] == 2 || got[1] == 3));
        return;
    }
    CHECK(got[0] == asked[0]);
    switch (got[0]) {
    case 1:
    case 2:
        CHECK(got[1] == (word(asked + 3) + 7) / 8 && size == 9 + got[1]);
        break;
    case 3:
    case 4:
    case 23:
        CHECK(got[1] == 2 * word(asked + 3) && size == 9 + got[1]);
        break;
    case 22:
        CHECK(size == 14 && memcmp(asked, got, 7) == 0);
        break;
    default:
        CHECK(size == 12 && memcmp(asked, got, 5) == 0);
    }
}

static int meets(int at, int count, int first, int last)
{
    return at <= last && at + count > first;
}

/* What those want, of requests that are not refused: by the function, not by tables. */
static int is_for_python(const uint8_t *pdu)
{
    int at, count;
    if (pdu[0] == 4)
        return 1;
    at = word(pdu + 1);
    count = word(pdu + 3);
    switch (pdu[0]) {
    case 1:
        return meets(at, count, 50, 60) || meets(at, count, 90, 90);
    case 6:
    case 22:
        return meets(at, 1, 150, 159);
    case 16:
        return meets(at, count, 150, 159);
    case 23:
        return meets(word(pdu + 5), word(pdu + 7), 150, 159);
    default:
        return 0;
    }
}

/* As many answers as requests were used, and nothing else. */
static void check_answers(const uint8_t *data, int used, int unit, int is_hooked)
{
    int at = 0, requests = 0, refused = 0;
    for (int start = 0; start < used; start += 6 + word(data + start + 4)) {
        CHECK(is_whole(data + start, used - start) && data[start + 6] == unit);
        CHECK(is_known(data[start + 7]));
        CHECK(is_whole(replier.answers + at, replier.size - at));
        CHECK(!is_hooked || (replier.answers[at + 7] & 0x80 ? data[start + 7] != 4
                                                            : !is_for_python(data + start + 7)));
        check_answer(data + start, replier.answers + at, 6 + word(replier.answers + at + 4));
        refused += replier.answers[at + 7] >> 7;
        requests++;
        at += 6 + word(replier.answers + at + 4);
    }
    CHECK(at == replier.size && requests == replier.requests && refused == replier.refused);
}

/* What was left must be for somebody else, or lack its end or the room for its answer. */
static void check_rest(const uint8_t *data, int size, int unit, int is_hooked)
{
    CHECK(!is_whole(data, size) || data[6] != unit || !is_known(data[7]) ||
          replier.room - replier.size < MODBUS_TCP_MAX_ADU_LENGTH ||
          (is_hooked && is_for_python(data + 7)));
}

/* Nobody writes into a hole. */
static void check_tables(void)
{
    const modbus_mapping_t *tables = &mapping.tables;
    for (int at = 0; at < tables->nb_bits; at++)
        CHECK(tables->tab_bits[at] <= 1);
    for (int at = 1000; at < 1003; at++)
        CHECK(tables->tab_bits[at - 10] == 0);
    CHECK(tables->tab_registers[101 - 100] == 0);
    for (int at = 200; at < 210; at++)
        CHECK(tables->tab_registers[at - 100] == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *input, size_t given)
{
    static tally_t tally;
    int unit, is_hooked, size, start = 0, end;
    uint8_t *data, stray;

    if (given < 2)
        return 0;
    if (replier.context == NULL)
        set_up();
    empty_tables();
    unit = input[0];
    is_hooked = input[1] & 1;
    replier.room = MODBUS_TCP_MAX_ADU_LENGTH + 37 * input[1];
    replier.answers = malloc((size_t)replier.room);
    size = (int)given - 2;
    data = malloc((size_t)size);
    if (size)
        memcpy(data, input + 2, (size_t)size);
    do {
        end = answer_chunk(&replier, &mapping, is_hooked ? &something : &nothing, &tally, unit,
                           data, start, size);
        CHECK(end >= start && end <= size);
        CHECK(replier.size <= replier.room && replier.unread == 0 && replier.unread_size == 0);
        check_answers(data + start, end - start, unit, is_hooked);
        check_rest(data + end, size - end, unit, is_hooked);
    } while (end > start && (start = end) < size);
    CHECK(recv(replier.outlet, &stray, 1, MSG_DONTWAIT) == -1);
    check_tables();
    free(data);
    free(replier.answers);
    return 0;
}
