/* The floor under every link: round trips over UDP on loopback, without an interpreter.
 *
 *   udp_echo echo  PORT PRIORITY CPU        sends back what it gets, at the length of a control packet
 *   udp_echo drive PORT PRIORITY CPU RATE   for every number N on standard input: N round trips, their ns on one line
 *
 * Both say "ready" first. The same conditions as hil/bench/links.py: SCHED_FIFO if allowed, one CPU each, absolute
 * CLOCK_MONOTONIC deadlines, 20 bytes there and 48 back, lost (-1) after 50 ms. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <signal.h>
#include <time.h>
#include <unistd.h>

enum { QUESTION = 20, ANSWER = 48 };

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void sleep_until(int64_t at)
{
    struct timespec t = {at / 1000000000LL, at % 1000000000LL};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

static void go_real_time(int priority, int cpu)
{
    struct sched_param p = {.sched_priority = priority};
    if (sched_setscheduler(0, SCHED_FIFO, &p) != 0)
        prctl(PR_SET_TIMERSLACK, 1);
    (void)mlockall(MCL_CURRENT | MCL_FUTURE);
    if (cpu >= 0) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET(cpu, &set);
        (void)sched_setaffinity(0, sizeof set, &set);
    }
}

static struct sockaddr_in loopback(int port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return a;
}

static int echo(int s, int port)
{
    struct sockaddr_in here = loopback(port), from;
    char buffer[256] = {0};
    if (bind(s, (struct sockaddr *)&here, sizeof here) != 0)
        return perror("bind"), 1;
    puts("ready");
    fflush(stdout);
    for (;;) {
        socklen_t size = sizeof from;
        if (recvfrom(s, buffer, sizeof buffer, 0, (struct sockaddr *)&from, &size) > 0)
            (void)sendto(s, buffer, ANSWER, 0, (struct sockaddr *)&from, size);
    }
}

static int drive(int s, int port, double rate)
{
    struct sockaddr_in there = loopback(port);
    struct timeval patience = {0, 50000};
    int64_t period = (int64_t)(1e9 / rate);
    char question[QUESTION] = {0}, answer[256];
    uint32_t seq = 0;
    long number;
    if (connect(s, (struct sockaddr *)&there, sizeof there) != 0)
        return perror("connect"), 1;
    setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    puts("ready");
    fflush(stdout);
    while (scanf("%ld", &number) == 1) {
        int64_t *taken = malloc(sizeof *taken * (size_t)(number > 0 ? number : 1));
        int64_t start = now() + 1000000;
        for (long k = 0; k < number; k++) {
            sleep_until(start + k * period);
            memcpy(question, &(uint32_t){++seq}, sizeof seq);
            int64_t begin = now();
            ssize_t got = -1;
            taken[k] = -1;
            if (send(s, question, QUESTION, 0) == QUESTION)
                while ((got = recv(s, answer, sizeof answer, 0)) >= 4 && memcmp(answer, &seq, sizeof seq) != 0)
                    ;
            if (got >= 4)
                taken[k] = now() - begin;
        }
        for (long k = 0; k < number; k++)
            printf("%lld ", (long long)taken[k]);
        puts("");
        fflush(stdout);
        free(taken);
    }
    return 0;
}

int main(int argc, char **argv)
{
    int s = socket(AF_INET, SOCK_DGRAM, 0);
    if (s < 0 || argc < 5)
        return 2;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    go_real_time(atoi(argv[3]), atoi(argv[4]));
    return argv[1][0] == 'e' ? echo(s, atoi(argv[2])) : drive(s, atoi(argv[2]), atof(argv[5]));
}
