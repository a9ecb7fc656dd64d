/* Send one request and receive the first bytes of its answer, in one call.
 *
 * It does not use the functions of libmodbus to wait and receive: their select() continues after a
 * signal and aborts the process for descriptors of 1024 and above, and modbus_receive_confirmation
 * does not return bytes that it cannot parse. */

#include <errno.h>
#include <poll.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <modbus/modbus.h>

enum { MBAP_SIZE = 7, ANSWER_SIZE = 512, NOT_SENT = -1, NOT_PLAIN = 0 };

/* context: the modbus_t of a serial port, or NULL for a socket.
 * answer, got: the bytes received, and their number; there is room for more than a frame, so that
 * extra bytes are noticed.
 * error: the errno of a failure to send or receive, or 0. */
typedef struct {
    modbus_t *context;
    uint8_t answer[ANSWER_SIZE];
    int got;
    int error;
} exchange_t;

/* On serial lines libmodbus appends the CRC and switches RTS; on TCP the header is written here,
 * because 3.1.6 sends raw requests with transaction id 0. */
static int send_request(exchange_t *exchange, int descriptor, int unit, int number,
                        const uint8_t *pdu, int size)
{
    uint8_t request[MBAP_SIZE + MODBUS_MAX_PDU_LENGTH] = {
        (uint8_t)(number >> 8), (uint8_t)number, 0, 0, (uint8_t)((size + 1) >> 8),
        (uint8_t)(size + 1), (uint8_t)unit};
    memcpy(request + MBAP_SIZE, pdu, (size_t)size);
    if (exchange->context)
        return modbus_send_raw_request(exchange->context, request + MBAP_SIZE - 1, size + 1);
    return (int)send(descriptor, request, (size_t)(MBAP_SIZE + size), MSG_NOSIGNAL);
}

/* Returns 1 if the bytes are one whole frame of Modbus/TCP with this id and unit. */
static int is_answer(const exchange_t *exchange, int unit, int number)
{
    const uint8_t *at = exchange->answer;
    return exchange->got > MBAP_SIZE && (at[0] << 8 | at[1]) == number && !at[2] && !at[3] &&
           (at[4] << 8 | at[5]) == exchange->got - 6 && at[6] == unit;
}

/* waker: readable when the wait must end; timeout: seconds.
 *
 * Returns the length of the PDU after the header of the answer, on a socket; NOT_PLAIN if the
 * caller must check the bytes, or there are none, or the wait was ended; NOT_SENT if there were
 * bytes before the request, or the connection has ended. */
static int exchange(exchange_t *exchange, int descriptor, int waker, int unit, int number,
                    const uint8_t *pdu, int size, double timeout)
{
    struct pollfd watched[2] = {{descriptor, POLLIN, 0}, {waker, POLLIN, 0}};
    ssize_t got;
    exchange->got = exchange->error = 0;
    if (size > MODBUS_MAX_PDU_LENGTH || poll(watched, 1, 0) != 0)
        return NOT_SENT;
    got = send_request(exchange, descriptor, unit, number, pdu, size);
    if (got != -1) {
        if (poll(watched, 2, (int)(timeout * 1000) + 1) < 1 || watched[1].revents)
            return NOT_PLAIN;
        got = read(descriptor, exchange->answer, ANSWER_SIZE);
    }
    if (got == -1 && errno != EAGAIN && errno != EINTR)
        exchange->error = errno;
    exchange->got = got > 0 ? (int)got : 0;
    return !exchange->context && is_answer(exchange, unit, number) ? exchange->got - MBAP_SIZE
                                                                   : NOT_PLAIN;
}
