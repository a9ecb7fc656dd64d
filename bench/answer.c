/*
 * The least a server can do: answers every read of holding registers with the
 * addresses themselves and checks nothing. The limit of `load`, and of any server.
 * Prints its port when it is ready.
 */

#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <unistd.h>

#define REQUEST 12
#define MOST 256    /* requests at a time */
#define ANSWER 259  /* bytes, at most */
#define MAX_EVENTS 1024

static int listen_anywhere(void)
{
    struct sockaddr_in address = {.sin_family = AF_INET};
    socklen_t size = sizeof address;
    int listener = socket(AF_INET, SOCK_STREAM, 0);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(listener, (struct sockaddr *)&address, size) == -1 || listen(listener, 1024) == -1 ||
        getsockname(listener, (struct sockaddr *)&address, &size) == -1)
        return -1;
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    return listener;
}

static size_t write_answer(uint8_t *answer, const uint8_t *request)
{
    unsigned address = (unsigned)request[8] << 8 | request[9];
    unsigned count = request[11];
    answer[0] = request[0];
    answer[1] = request[1];
    answer[2] = answer[3] = 0;
    answer[4] = (uint8_t)((3 + 2 * count) >> 8);
    answer[5] = (uint8_t)(3 + 2 * count);
    answer[6] = request[6];
    answer[7] = 3;
    answer[8] = (uint8_t)(2 * count);
    for (unsigned index = 0; index < count; index++) {
        answer[9 + 2 * index] = (uint8_t)((address + index) >> 8);
        answer[10 + 2 * index] = (uint8_t)(address + index);
    }
    return 9 + 2 * count;
}

static void answer(int client)
{
    static uint8_t requests[MOST * REQUEST], answers[MOST * ANSWER];
    ssize_t got = recv(client, requests, sizeof requests, 0);
    size_t length = 0;
    if (got <= 0 || got % REQUEST != 0) {
        close(client);
        return;
    }
    for (ssize_t start = 0; start < got; start += REQUEST)
        length += write_answer(answers + length, requests + start);
    if (send(client, answers, length, MSG_NOSIGNAL) != (ssize_t)length)
        close(client);
}

static void welcome(int epoll, int listener)
{
    int on = 1;
    int client = accept(listener, NULL, NULL);
    struct epoll_event event = {EPOLLIN, {.fd = client}};
    if (client == -1)
        return;
    setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    epoll_ctl(epoll, EPOLL_CTL_ADD, client, &event);
}

int main(void)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* no process stays behind */
    int epoll = epoll_create1(0), listener = listen_anywhere();
    struct epoll_event events[MAX_EVENTS], event = {EPOLLIN, {.fd = listener}};
    if (listener == -1 || epoll_ctl(epoll, EPOLL_CTL_ADD, listener, &event) == -1) {
        perror("listen");
        return 1;
    }
    for (;;) {
        int ready = epoll_wait(epoll, events, MAX_EVENTS, -1);
        for (int index = 0; index < ready; index++) {
            if (events[index].data.fd == listener)
                welcome(epoll, listener);
            else
                answer(events[index].data.fd);
        }
    }
}
