/* libmodbus's own client in a loop: client PORT COUNT -> requests per second. */

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <modbus/modbus.h>

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + (double)time.tv_nsec / 1e9;
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        fprintf(stderr, "usage: client PORT COUNT\n");
        return 2;
    }
    modbus_t *context = modbus_new_tcp("127.0.0.1", atoi(argv[1]));
    int count = atoi(argv[2]);
    uint16_t values[10];
    if (context == NULL || modbus_connect(context) == -1) {
        perror("connect");
        return 1;
    }
    double start = now();
    for (int i = 0; i < count; i++) {
        if (modbus_read_registers(context, 0, 10, values) != 10) {
            perror("read");
            return 1;
        }
    }
    printf("%.0f\n", count / (now() - start));
    modbus_close(context);
    modbus_free(context);
    return 0;
}
