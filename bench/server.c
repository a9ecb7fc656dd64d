/* libmodbus's own server, one client after the other; prints its port when it is ready. */

#include <netinet/in.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <modbus/modbus.h>

int main(void)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* no process stays behind */
    modbus_t *context = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *mapping = modbus_mapping_new(1000, 1000, 1000, 1000);
    int listener = modbus_tcp_listen(context, 5);
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    if (mapping == NULL || listener == -1 ||
        getsockname(listener, (struct sockaddr *)&address, &size) == -1) {
        perror("listen");
        return 1;
    }
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    for (;;) {
        uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
        int length;
        if (modbus_tcp_accept(context, &listener) == -1)
            return 1;
        while ((length = modbus_receive(context, request)) != -1)
            modbus_reply(context, request, length, mapping);
        modbus_close(context);
    }
}
