/* Send one request and receive the first bytes that follow, in one call.
 *
 * It does not use the functions of libmodbus to wait and receive: their select() continues after a
 * signal and aborts the process for descriptors of 1024 and above, and modbus_receive_confirmation
 * does not return bytes that it cannot parse. */

#include <errno.h>
#include <poll.h>
#include <stdint.h>
#include <sys/socket.h>
#include <unistd.h>

#include <modbus/modbus.h>

enum { CRC_SIZE = 2, ANSWER_SIZE = 512, NOTHING = 0, NOT_SENT = -1, FAILED = -2 };

/* context: the modbus_t of a serial port, or NULL for a socket.
 * answer: the bytes received; there is room for more than a frame, so that extra bytes are noticed.
 * error: the errno of a failure to send or receive. */
typedef struct {
    modbus_t *context;
    uint8_t answer[ANSWER_SIZE];
    int error;
} exchange_t;

/* waker: readable when the wait must end; timeout: seconds.
 *
 * On serial lines libmodbus appends the CRC and switches RTS.
 *
 * Returns the number of bytes received, or NOTHING; NOT_SENT, because there are bytes to read, or
 * the connection has ended; or FAILED. */
static int exchange(exchange_t *exchange, int descriptor, int waker, const uint8_t *adu, int size,
                    double timeout)
{
    struct pollfd watched[2] = {{descriptor, POLLIN, 0}, {waker, POLLIN, 0}};
    ssize_t got;
    if (poll(watched, 1, 0) != 0)
        return NOT_SENT;
    if (exchange->context)
        got = modbus_send_raw_request(exchange->context, adu, size - CRC_SIZE);
    else
        got = send(descriptor, adu, (size_t)size, MSG_NOSIGNAL);
    if (got != -1) {
        if (poll(watched, 2, (int)(timeout * 1000) + 1) < 1 || watched[1].revents)
            return NOTHING;
        got = read(descriptor, exchange->answer, ANSWER_SIZE);
    }
    if (got != -1)
        return (int)got;
    exchange->error = errno;
    return errno == EAGAIN || errno == EINTR ? NOTHING : FAILED;
}
