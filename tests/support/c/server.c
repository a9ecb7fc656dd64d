/*
 * A server for the tests: libmodbus alone, with the tables of tests/interop.py.
 *
 *     server tcp PORT               port 0 takes a free one
 *     server rtu DEVICE BAUD UNIT
 *
 * Prints "ready PORT" (0 for a serial port) once it can be reached, and ends
 * as soon as its standard input is closed.
 */

#include <arpa/inet.h>
#include <errno.h>
#include <modbus/modbus.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { COILS = 10, INPUTS = 20, HOLDINGS = 100, READINGS = 200 };

static void die(const char *what)
{
    fprintf(stderr, "%s: %s\n", what, modbus_strerror(errno));
    exit(1);
}

static void *end_with_input(void *nothing)
{
    char byte;

    while (read(STDIN_FILENO, &byte, 1) > 0)
        ;
    _exit(0);
    return nothing;
}

static modbus_mapping_t *make_tables(void)
{
    modbus_mapping_t *tables =
        modbus_mapping_new_start_address(COILS, 2100, INPUTS, 2100, HOLDINGS, 300, READINGS, 200);

    if (tables == NULL)
        die("tables");
    for (int i = 0; i < tables->nb_bits; i++)
        tables->tab_bits[i] = (COILS + i) % 3 == 0;
    for (int i = 0; i < tables->nb_input_bits; i++)
        tables->tab_input_bits[i] = (INPUTS + i) % 5 < 2;
    for (int i = 0; i < tables->nb_registers; i++)
        tables->tab_registers[i] = 1000 + HOLDINGS + i;
    for (int i = 0; i < tables->nb_input_registers; i++)
        tables->tab_input_registers[i] = 65535 - (READINGS + i);
    return tables;
}

static void ready(int port)
{
    printf("ready %d\n", port);
    fflush(stdout);
}

/* Until the client is gone, or for ever on a line that no one can leave. */
static void serve(modbus_t *context, modbus_mapping_t *tables, int is_line)
{
    uint8_t request[MODBUS_MAX_ADU_LENGTH];

    for (;;) {
        int length = modbus_receive(context, request);

        if (length > 0)
            modbus_reply(context, request, length, tables);
        else if (length < 0 && (!is_line || errno == EIO || errno == EBADF))
            return;
    }
}

static void serve_tcp(int port, modbus_mapping_t *tables)
{
    modbus_t *context = modbus_new_tcp("127.0.0.1", port);
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    int listener = context == NULL ? -1 : modbus_tcp_listen(context, 5);

    if (listener == -1 || getsockname(listener, (struct sockaddr *)&address, &size) == -1)
        die("listen");
    ready(ntohs(address.sin_port));
    while (modbus_tcp_accept(context, &listener) != -1) {
        serve(context, tables, 0);
        modbus_close(context);
    }
    die("accept");
}

static void serve_rtu(const char *device, int baud, int unit, modbus_mapping_t *tables)
{
    modbus_t *context = modbus_new_rtu(device, baud, 'E', 8, 1);

    if (context == NULL || modbus_set_slave(context, unit) == -1 || modbus_connect(context) == -1)
        die(device);
    ready(0);
    serve(context, tables, 1);
    die(device);
}

int main(int count, char **words)
{
    pthread_t watcher;
    modbus_mapping_t *tables = make_tables();

    if (pthread_create(&watcher, NULL, end_with_input, NULL) != 0)
        die("thread");
    if (count == 3 && strcmp(words[1], "tcp") == 0)
        serve_tcp(atoi(words[2]), tables);
    if (count == 5 && strcmp(words[1], "rtu") == 0)
        serve_rtu(words[2], atoi(words[3]), atoi(words[4]), tables);
    fprintf(stderr, "server tcp PORT | server rtu DEVICE BAUD UNIT\n");
    return 2;
}
