/* One request and the first bytes that come back, in one call: look, send, wait, read.
 *
 * The waiting is ours: libmodbus's select goes on after a signal, and aborts the process on
 * descriptors of 1024 and above; its receive keeps the bytes of what it does not understand. */

#include <errno.h>
#include <poll.h>
#include <stdint.h>
#include <sys/socket.h>
#include <unistd.h>

#include <modbus/modbus.h>

enum { NOT_SENT = -1, NOTHING_YET = 0 };

/* context: the modbus_t of a serial port, which sends `request` (unit and PDU) with its CRC
 * and turns the line round; NULL for a socket, where `request` is the whole frame.
 * waker: readable when the wait must end.
 *
 * Gives how many bytes came; NOTHING_YET if none did in time, or the wait was ended; NOT_SENT
 * if bytes were there that nobody asked for, or the connection has ended. */
static int exchange(modbus_t *context, int descriptor, int waker, const uint8_t *request, int size,
                    int milliseconds, uint8_t *answer, int room)
{
    struct pollfd watched[2] = {{descriptor, POLLIN, 0}, {waker, POLLIN, 0}};
    ssize_t got;
    if (poll(watched, 1, 0) != 0)
        return NOT_SENT;
    got = context ? modbus_send_raw_request(context, request, size)
                  : send(descriptor, request, (size_t)size, MSG_NOSIGNAL);
    if (got == -1 || poll(watched, 2, milliseconds) < 1 || watched[1].revents)
        return NOTHING_YET;
    got = read(descriptor, answer, (size_t)room);
    return got > 0 ? (int)got : NOTHING_YET;
}
