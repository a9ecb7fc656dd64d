/*
 * The limit of a blocking client: pingpong REQUEST ANSWER SECONDS
 *
 * Two processes that do nothing but send each other as many bytes as a request and its
 * answer have, over loopback TCP, one at a time. Prints requests, seconds, and seconds
 * of processor time as JSON.
 */

#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define MOST 300

static char bytes[MOST];

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + (double)time.tv_nsec / 1e9;
}

static double processor_time(int who)
{
    struct rusage usage;
    getrusage(who, &usage);
    return (double)(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
           (double)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
}

static void turn_off_delay(int descriptor)
{
    int on = 1;
    setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
}

static int exchange(int descriptor, size_t give, size_t take)
{
    return send(descriptor, bytes, give, MSG_NOSIGNAL) == (ssize_t)give &&
           recv(descriptor, bytes, take, MSG_WAITALL) == (ssize_t)take;
}

static int answer_all(int listener, size_t request, size_t answer)
{
    int client = accept(listener, NULL, NULL);
    turn_off_delay(client);
    if (recv(client, bytes, request, MSG_WAITALL) == (ssize_t)request)
        while (exchange(client, answer, request))
            ;
    return 0;
}

static int ask_all(struct sockaddr_in *server, size_t request, size_t answer, double seconds)
{
    int client = socket(AF_INET, SOCK_STREAM, 0);
    long requests = 0;
    if (connect(client, (struct sockaddr *)server, sizeof *server) == -1) {
        perror("connect");
        return 1;
    }
    turn_off_delay(client);
    double start = now(), time;
    while ((time = now()) < start + seconds && exchange(client, request, answer))
        requests++;
    close(client);
    wait(NULL);
    printf("{\"requests\": %ld, \"seconds\": %.6f, \"client_cpu\": %.6f, \"server_cpu\": %.6f}\n",
           requests, time - start, processor_time(RUSAGE_SELF), processor_time(RUSAGE_CHILDREN));
    return 0;
}

int main(int argc, char **argv)
{
    struct sockaddr_in server = {.sin_family = AF_INET};
    socklen_t size = sizeof server;
    int listener = socket(AF_INET, SOCK_STREAM, 0);
    if (argc != 4 || atoi(argv[1]) < 1 || atoi(argv[1]) > MOST || atoi(argv[2]) < 1 ||
        atoi(argv[2]) > MOST) {
        fprintf(stderr, "usage: pingpong REQUEST ANSWER SECONDS, 1..%d bytes\n", MOST);
        return 2;
    }
    size_t request = (size_t)atoi(argv[1]), answer = (size_t)atoi(argv[2]);
    server.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(listener, (struct sockaddr *)&server, size) == -1 || listen(listener, 1) == -1 ||
        getsockname(listener, (struct sockaddr *)&server, &size) == -1) {
        perror("listen");
        return 1;
    }
    pid_t child = fork();
    if (child == -1)
        return 1;
    if (child == 0)
        return answer_all(listener, request, answer);
    close(listener);
    return ask_all(&server, request, answer, atof(argv[3]));
}
