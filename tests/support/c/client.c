/*
 * A client for the tests: every request that libmodbus has a call for, at its
 * limit, against a server with the tables of tests/interop.py.
 *
 *     client tcp PORT UNIT
 *     client rtu DEVICE BAUD UNIT
 *
 * Prints a line a request, "FC 3 ok" or "FC 3 failed: why"; then, for addresses
 * that do not exist, "FC 3 refused" or "FC 3 not refused: why". The exit status
 * is 0 if nothing failed.
 */

#include <errno.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static modbus_t *context;
static int failures;

static void report(int code, int good, const char *well, const char *badly)
{
    if (good)
        printf("FC %d %s\n", code, well);
    else
        printf("FC %d %s: %s\n", code, badly, modbus_strerror(errno));
    failures += !good;
}

static void done(int code, int good)
{
    report(code, good, "ok", "failed");
}

static void refused(int code, int result, int reason)
{
    report(code, result == -1 && errno == reason, "refused", "not refused");
}

static int coil(int address)
{
    return address % 3 == 0;
}

static int input(int address)
{
    return address % 5 < 2;
}

static int holding(int address)
{
    return 1000 + address;
}

static int reading(int address)
{
    return 65535 - address;
}

static int bits_are(int first, int count, const uint8_t *bits, int (*expected)(int))
{
    for (int i = 0; i < count; i++)
        if (bits[i] != expected(first + i))
            return 0;
    return 1;
}

static int registers_are(int first, int count, const uint16_t *values, int (*expected)(int))
{
    for (int i = 0; i < count; i++)
        if (values[i] != expected(first + i))
            return 0;
    return 1;
}

static int other_coil(int address)
{
    return !coil(address);
}

static int tripled(int address)
{
    return 3 * address;
}

static void read_tables(void)
{
    uint8_t bits[2000];
    uint16_t values[125];

    done(1, modbus_read_bits(context, 10, 2000, bits) == 2000 && bits_are(10, 2000, bits, coil));
    done(2, modbus_read_input_bits(context, 20, 2000, bits) == 2000 &&
                bits_are(20, 2000, bits, input));
    done(3, modbus_read_registers(context, 100, 125, values) == 125 &&
                registers_are(100, 125, values, holding));
    done(4, modbus_read_input_registers(context, 200, 125, values) == 125 &&
                registers_are(200, 125, values, reading));
}

static void write_bits(void)
{
    uint8_t bits[1968];

    done(5, modbus_write_bit(context, 2109, 1) == 1 &&
                modbus_read_bits(context, 2108, 2, bits) == 2 && bits[0] == coil(2108) &&
                bits[1] == 1);
    for (int i = 0; i < 1968; i++)
        bits[i] = other_coil(10 + i);
    done(15, modbus_write_bits(context, 10, 1968, bits) == 1968 &&
                 modbus_read_bits(context, 10, 1968, bits) == 1968 &&
                 bits_are(10, 1968, bits, other_coil));
}

static void write_registers(void)
{
    uint16_t values[125];
    uint16_t back[125];

    done(6, modbus_write_register(context, 399, 65535) == 1 &&
                modbus_read_registers(context, 398, 2, back) == 2 && back[0] == holding(398) &&
                back[1] == 65535);
    for (int i = 0; i < 125; i++)
        values[i] = tripled(100 + i);
    done(16, modbus_write_registers(context, 100, 123, values) == 123 &&
                 modbus_read_registers(context, 100, 123, back) == 123 &&
                 registers_are(100, 123, back, tripled));
    /* 1250 is 04E2h: bits 4..7 stay, the others come from the second mask. */
    done(22, modbus_mask_write_register(context, 250, 0x00F0, 0xA50F) == 1 &&
                 modbus_read_registers(context, 250, 1, back) == 1 && back[0] == 0xA5EF);
    for (int i = 0; i < 121; i++)
        values[i] = tripled(270 + i);
    done(23, modbus_write_and_read_registers(context, 270, 121, values, 266, 125, back) == 125 &&
                 registers_are(266, 4, back, holding) &&
                 registers_are(270, 121, back + 4, tripled));
}

static void ask_who_it_is(void)
{
    static const uint8_t expected[] = "\x01\xff" "libmodbus-py"; /* and a zero that does not count */
    const int size = sizeof expected - 1;
    uint8_t answer[64];

    done(17, modbus_report_slave_id(context, sizeof answer, answer) == size &&
                 memcmp(answer, expected, size) == 0);
}

static void ask_for_what_is_not_there(void)
{
    uint8_t bits[16] = {0};
    uint16_t values[16] = {0};

    refused(1, modbus_read_bits(context, 9, 1, bits), EMBXILADD);
    refused(2, modbus_read_input_bits(context, 2119, 2, bits), EMBXILADD);
    refused(3, modbus_read_registers(context, 399, 2, values), EMBXILADD);
    refused(4, modbus_read_input_registers(context, 199, 1, values), EMBXILADD);
    refused(5, modbus_write_bit(context, 2110, 1), EMBXILADD);
    refused(6, modbus_write_register(context, 99, 1), EMBXILADD);
    refused(15, modbus_write_bits(context, 2100, 11, bits), EMBXILADD);
    refused(16, modbus_write_registers(context, 398, 3, values), EMBXILADD);
    refused(22, modbus_mask_write_register(context, 400, 0, 0), EMBXILADD);
    refused(23, modbus_write_and_read_registers(context, 100, 1, values, 400, 1, values + 1),
            EMBXILADD);
}

int main(int count, char **words)
{
    if (count == 4 && strcmp(words[1], "tcp") == 0)
        context = modbus_new_tcp("127.0.0.1", atoi(words[2]));
    else if (count == 5 && strcmp(words[1], "rtu") == 0)
        context = modbus_new_rtu(words[2], atoi(words[3]), 'E', 8, 1);
    if (context == NULL) {
        fprintf(stderr, "client tcp PORT UNIT | client rtu DEVICE BAUD UNIT\n");
        return 2;
    }
    modbus_set_response_timeout(context, 5, 0);
    modbus_set_byte_timeout(context, 0, 0);
    if (modbus_set_slave(context, atoi(words[count - 1])) == -1 ||
        modbus_connect(context) == -1) {
        fprintf(stderr, "connect: %s\n", modbus_strerror(errno));
        return 2;
    }
    read_tables();
    write_bits();
    write_registers();
    ask_who_it_is();
    ask_for_what_is_not_there();
    modbus_close(context);
    modbus_free(context);
    return failures != 0;
}
