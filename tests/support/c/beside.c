/* beside: the server's C helper (answer_chunk.c) on a modbus_reply that checks no address.
 *
 * Every function is tried with every first address and many counts, on tables that lie in
 * the middle of memory that nobody may touch. Prints how many requests were refused with
 * exception 2 and how many were executed; complains and fails if one was executed that
 * is not within its tables, or refused that is. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <modbus/modbus.h>

static int trusting_reply(modbus_t *context, const uint8_t *request, int size,
                          modbus_mapping_t *tables);
#define modbus_reply trusting_reply
#include "../../../libmodbus_py/binding/answer_chunk.c"

enum { SPACE = 65536, GUARD = 0x5A, FIRST = 1000, COUNT = 40 };

static uint8_t bits[3 * SPACE], input_bits[3 * SPACE];
static uint16_t registers[3 * SPACE], input_registers[3 * SPACE];
static replier_t replier;
static int inlet, executed, refused, outside;

/* As libmodbus does it, but that no address is looked at; of the answers only their size counts. */
static int trusting_reply(modbus_t *context, const uint8_t *request, int size,
                          modbus_mapping_t *tables)
{
    static const uint8_t answer[12] = {0, 0, 0, 0, 0, 6};
    const uint8_t *pdu = request + 7;
    int first = word(pdu + 1), count = word(pdu + 3);
    (void)context;
    (void)size;
    executed++;
    switch (pdu[0]) {
    case 5:
        tables->tab_bits[first - FIRST] = 1;
        break;
    case 15:
        memset(tables->tab_bits + first - FIRST, 1, (size_t)count);
        break;
    case 6:
    case 22:
        tables->tab_registers[first - FIRST] = 1;
        break;
    case 23:
        outside += first < FIRST || first + count > FIRST + COUNT;
        first = word(pdu + 5);
        count = word(pdu + 7);
        /* fall through */
    case 16:
        memset(tables->tab_registers + first - FIRST, 1, 2 * (size_t)count);
        break;
    default:
        outside += first < FIRST || first + count > FIRST + COUNT;
    }
    return (int)write(inlet, answer, sizeof answer);
}

static void ask(mapping_t *mapping, const uint8_t *pdu, int size, int is_inside)
{
    static const watched_t nothing = {.functions = 0xFFFFFFFF};
    static tally_t tally;
    uint8_t frame[260] = {0, 0, 0, 0, 0, (uint8_t)(1 + size), 1};
    int before = executed;
    memcpy(frame + 7, pdu, (size_t)size);
    if (answer_chunk(&replier, mapping, &nothing, &tally, 1, frame, 0, 7 + size) != 7 + size)
        abort();
    if (executed == before && (replier.size != 9 || replier.answers[8] != 2))
        abort();
    refused += executed == before;
    if ((executed > before) != is_inside) {
        outside++;
        if (outside < 5)
            fprintf(stderr, "function %d at %d\n", pdu[0], word(pdu + 1));
    }
}

static void put(uint8_t *at, int value)
{
    at[0] = (uint8_t)(value >> 8);
    at[1] = (uint8_t)value;
}

static int is_inside(int first, int count)
{
    return first >= FIRST && first + count <= FIRST + COUNT;
}

static void try_address(mapping_t *mapping, int first, int count)
{
    uint8_t pdu[253] = {0};
    put(pdu + 1, first);
    put(pdu + 3, count);
    for (pdu[0] = 1; pdu[0] <= 4; pdu[0]++)
        ask(mapping, pdu, 5, is_inside(first, count));
    pdu[0] = 15;
    pdu[5] = (uint8_t)((count + 7) / 8);
    ask(mapping, pdu, 6 + pdu[5], is_inside(first, count));
    pdu[0] = 16;
    pdu[5] = (uint8_t)(2 * count);
    ask(mapping, pdu, 6 + pdu[5], is_inside(first, count));
    memset(pdu + 3, 0, 2);
    pdu[0] = 5;
    ask(mapping, pdu, 5, is_inside(first, 1));
    pdu[0] = 6;
    ask(mapping, pdu, 5, is_inside(first, 1));
    pdu[0] = 22;
    ask(mapping, pdu, 7, is_inside(first, 1));
    pdu[0] = 23; /* reads here, writes where it may; and the other way round */
    put(pdu + 3, count);
    put(pdu + 5, FIRST);
    put(pdu + 7, 1);
    pdu[9] = 2;
    ask(mapping, pdu, 12, is_inside(first, count));
    put(pdu + 1, FIRST);
    put(pdu + 3, 1);
    put(pdu + 5, first);
    put(pdu + 7, count);
    pdu[9] = (uint8_t)(2 * count);
    ask(mapping, pdu, 10 + 2 * count, is_inside(first, count));
}

static int is_untouched(const void *table, int width)
{
    const uint8_t *bytes = table;
    for (long at = 0; at < 3L * SPACE * width; at++)
        if ((at < (long)SPACE * width || at >= (long)(SPACE + COUNT) * width) && bytes[at] != GUARD)
            return 0;
    return 1;
}

int main(void)
{
    static const uint16_t edges[] = {FIRST, FIRST + COUNT - 1};
    static uint8_t answers[512];
    static const int counts[] = {1, 2, COUNT - 1, COUNT, COUNT + 1, 121};
    mapping_t mapping = {{.nb_bits = COUNT, .start_bits = FIRST,
                          .nb_input_bits = COUNT, .start_input_bits = FIRST,
                          .nb_registers = COUNT, .start_registers = FIRST,
                          .nb_input_registers = COUNT, .start_input_registers = FIRST,
                          .tab_bits = bits + SPACE, .tab_input_bits = input_bits + SPACE,
                          .tab_registers = registers + SPACE,
                          .tab_input_registers = input_registers + SPACE},
                         {{1, edges}, {1, edges}, {1, edges}, {1, edges}}};
    int pair[2];
    memset(bits, GUARD, sizeof bits);
    memset(registers, GUARD, sizeof registers);
    if (socketpair(AF_UNIX, SOCK_STREAM, 0, pair))
        abort();
    replier.outlet = pair[0];
    inlet = pair[1];
    replier.answers = answers;
    replier.room = sizeof answers;
    for (int first = 0; first < SPACE; first++)
        for (size_t at = 0; at < sizeof counts / sizeof *counts; at++)
            try_address(&mapping, first, counts[at]);
    if (!is_untouched(bits, 1) || !is_untouched(registers, 2))
        fprintf(stderr, "written beside a table\n");
    printf("%d refused, %d executed\n", refused, executed);
    return outside || !is_untouched(bits, 1) || !is_untouched(registers, 2);
}
