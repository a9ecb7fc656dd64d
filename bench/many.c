/*
 * libmodbus's server for many clients: one select loop, modbus_receive, modbus_reply.
 * Holding register N holds N. Prints its port when it is ready.
 *
 * select ends at descriptor 1023 (FD_SETSIZE), here and inside libmodbus: a client
 * beyond it is turned away.
 */

#include <netinet/in.h>
#include <signal.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <unistd.h>

#include <modbus/modbus.h>

#define REGISTERS 65536

static fd_set clients;
static int highest;

static int listen_anywhere(modbus_t *context)
{
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    int listener = modbus_tcp_listen(context, 1024);
    if (listener == -1 || getsockname(listener, (struct sockaddr *)&address, &size) == -1)
        return -1;
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    return listener;
}

static void welcome(int listener)
{
    int client = accept(listener, NULL, NULL);
    if (client == -1)
        return;
    if (client >= FD_SETSIZE) {
        close(client);
        return;
    }
    FD_SET(client, &clients);
    if (client > highest)
        highest = client;
}

static void answer(modbus_t *context, int client, modbus_mapping_t *mapping)
{
    uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
    modbus_set_socket(context, client);
    int length = modbus_receive(context, request);
    if (length > 0 && modbus_reply(context, request, length, mapping) != -1)
        return;
    if (length == 0)
        return; /* not for us */
    FD_CLR(client, &clients);
    close(client);
}

int main(void)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* no process stays behind */
    modbus_t *context = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *mapping = modbus_mapping_new(0, 0, REGISTERS, 0);
    if (context == NULL || mapping == NULL)
        return 1;
    for (int address = 0; address < REGISTERS; address++)
        mapping->tab_registers[address] = (uint16_t)address;
    int listener = listen_anywhere(context);
    if (listener == -1) {
        perror("listen");
        return 1;
    }
    FD_SET(listener, &clients);
    highest = listener;
    for (;;) {
        fd_set ready = clients;
        if (select(highest + 1, &ready, NULL, NULL, NULL) == -1)
            return 1;
        for (int descriptor = 0; descriptor <= highest; descriptor++) {
            if (!FD_ISSET(descriptor, &ready))
                continue;
            if (descriptor == listener)
                welcome(listener);
            else
                answer(context, descriptor, mapping);
        }
    }
}
