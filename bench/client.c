/*
 * libmodbus's own client:
 *
 *     client tcp PORT BLOCKS COUNT
 *     client rtu DEVICE BLOCKS COUNT
 *
 * For each line with a number of seconds it connects, reads BLOCKS blocks of COUNT
 * holding registers again and again for so long, and prints requests, seconds and
 * seconds of processor time as JSON. Register N must hold N, which is checked while
 * the clock stands. Says "ready" first.
 */

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <modbus/modbus.h>

#define REGISTERS 65500 /* of the server; a multiple of 10 and of 125 */

static int blocks, count;
static uint16_t *values;

static double seconds_of(clockid_t clock)
{
    struct timespec time;
    clock_gettime(clock, &time);
    return (double)time.tv_sec + (double)time.tv_nsec / 1e9;
}

static int address_of(int block)
{
    return block * count % REGISTERS;
}

static int read_all(modbus_t *context)
{
    for (int block = 0; block < blocks; block++)
        if (modbus_read_registers(context, address_of(block), count, values + block * count) == -1)
            return -1;
    return 0;
}

static int check_all(void)
{
    for (int block = 0; block < blocks; block++)
        for (int index = 0; index < count; index++)
            if (values[block * count + index] != address_of(block) + index)
                return -1;
    memset(values, 0xFF, sizeof *values * (size_t)(blocks * count));
    return 0;
}

static const char *measure(modbus_t *context, double least)
{
    double seconds = 0, processor = 0;
    long requests = 0;
    while (seconds < least) {
        double start = seconds_of(CLOCK_MONOTONIC);
        double processor_start = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
        if (read_all(context) == -1)
            return modbus_strerror(errno);
        processor += seconds_of(CLOCK_PROCESS_CPUTIME_ID) - processor_start;
        seconds += seconds_of(CLOCK_MONOTONIC) - start;
        requests += blocks;
        if (check_all() == -1)
            return "wrong values";
    }
    printf("{\"requests\": %ld, \"seconds\": %.6f, \"client_cpu\": %.6f}\n", requests, seconds,
           processor);
    return NULL;
}

static modbus_t *make(const char *transport, const char *place)
{
    if (strcmp(transport, "tcp") == 0)
        return modbus_new_tcp("127.0.0.1", atoi(place));
    return modbus_new_rtu(place, 115200, 'N', 8, 1);
}

int main(int argc, char **argv)
{
    char line[64];
    if (argc != 5) {
        fprintf(stderr, "usage: client tcp|rtu PORT|DEVICE BLOCKS COUNT\n");
        return 2;
    }
    blocks = atoi(argv[3]);
    count = atoi(argv[4]);
    values = calloc((size_t)(blocks * count), sizeof *values);
    modbus_t *context = make(argv[1], argv[2]);
    if (context == NULL || values == NULL || modbus_set_slave(context, 1) == -1) {
        perror("client");
        return 1;
    }
    printf("\"ready\"\n");
    fflush(stdout);
    while (fgets(line, sizeof line, stdin) != NULL) {
        const char *failure =
            modbus_connect(context) == -1 ? modbus_strerror(errno) : measure(context, atof(line));
        if (failure != NULL)
            printf("{\"failed\": \"%s\"}\n", failure);
        fflush(stdout);
        modbus_close(context);
    }
    modbus_free(context);
    return 0;
}
