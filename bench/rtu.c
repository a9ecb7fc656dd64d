/*
 * libmodbus's RTU server as unit 1, at the master of a pseudo-terminal. Holding
 * register N holds N. Prints the path of the other end, for one client at a time.
 */

#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <termios.h>
#include <unistd.h>

#include <modbus/modbus.h>

#define REGISTERS 65536

/* Keeps the other end open, too: clients come and go. */
static int open_terminal(void)
{
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master == -1 || grantpt(master) == -1 || unlockpt(master) == -1)
        return -1;
    int slave = open(ptsname(master), O_RDWR | O_NOCTTY);
    struct termios settings;
    if (slave == -1 || tcgetattr(slave, &settings) == -1)
        return -1;
    cfmakeraw(&settings);
    return tcsetattr(slave, TCSANOW, &settings) == -1 ? -1 : master;
}

int main(void)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* no process stays behind */
    int master = open_terminal();
    if (master == -1) {
        perror("open a pseudo-terminal");
        return 1;
    }
    modbus_t *context = modbus_new_rtu(ptsname(master), 115200, 'N', 8, 1);
    modbus_mapping_t *mapping = modbus_mapping_new(0, 0, REGISTERS, 0);
    if (context == NULL || mapping == NULL || modbus_set_slave(context, 1) == -1)
        return 1;
    for (int address = 0; address < REGISTERS; address++)
        mapping->tab_registers[address] = (uint16_t)address;
    modbus_set_socket(context, master);
    printf("%s\n", ptsname(master));
    fflush(stdout);
    for (;;) {
        uint8_t request[MODBUS_RTU_MAX_ADU_LENGTH];
        int length = modbus_receive(context, request);
        if (length > 0)
            modbus_reply(context, request, length, mapping);
    }
}
