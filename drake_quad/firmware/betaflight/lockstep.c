/*
Library that is preloaded into the simulator build of Betaflight, and makes the firmware run in lockstep with a simulation.

The firmware has a main thread and three worker threads: one receives the state of the vehicle, one the channels of the
remote control, and one serves the serial ports. They use a real clock and network sockets. This library
replaces the functions of the C library that they call:

- The clock is virtual. It advances when the main thread sleeps and, by 50 ns, at each call of clock_gettime, so that
  loops that wait for a time end. When a sleep reaches the time to which the simulation allows the firmware to run, the
  process sends a reply and waits for the next request.
- The workers are coroutines instead of threads. They run only during a request, in a fixed order, so a flight does not
  depend on the scheduler of the operating system.
- Datagrams are parts of requests and replies. Serial ports are Unix sockets in the working folder. The process never
  opens a network socket, so many firmware processes can run side by side.

The environment variable LOCKSTEP_SOCKET contains the number of an open socket (SOCK_SEQPACKET) over which the
process receives requests and sends replies. The process ends when the other end is closed or its parent has died.
*/
#define _GNU_SOURCE
#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/un.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

#define STACK_SIZE (512 * 1024) /* bytes of stack of a coroutine */
#define MAX_WORKERS 8
#define MAX_FILES 1024
#define CHECK_INTERVAL 1 /* s between two checks whether the parent still lives */
#define START_TIME 1000000000ull /* ns; the firmware takes 0 for "never" */
#define READING_TIME 50 /* ns that pass when the clock is read */
#define LOOP_SLEEP 50000 /* ns for which the firmware sleeps in each pass of its main loop */

/* Ports of the firmware's datagrams. */
enum { MOTOR_PORT = 9002, STATE_PORT = 9003, CHANNEL_PORT = 9004 };

/* Packets, as the header of the firmware's simulator target defines them. */
typedef struct { double numbers[18]; } state_packet;
typedef struct { double time; uint16_t channels[16]; } channel_packet;

typedef struct {
    uint64_t until; /* time to which the firmware shall run, ns */
    uint32_t has_state, has_channels, runs_serial, unused;
    state_packet state;
    channel_packet channels;
} request_t;

typedef struct {
    uint64_t now; /* time of the firmware, ns */
    uint32_t is_running; /* 1 if the firmware has finished its initialization */
    uint32_t num_updates; /* number of motor commands since the last reply */
    float motors[4];
} reply_t;

typedef struct {
    ucontext_t context;
    void *(*function)(void *);
    void *argument;
    int port; /* port at which the worker waits for a datagram; 0 if it waits for other files */
} worker_t;

static uint64_t now = START_TIME;
static request_t request;
static reply_t reply;
static int lockstep_socket = -1;
static pid_t parent;
static ucontext_t main_context;
static worker_t workers[MAX_WORKERS];
static int num_workers;
static worker_t *current; /* worker that runs; NULL for the main thread */
static int port_of_file[MAX_FILES]; /* port of each datagram socket; 0 for other files */

static void check_parent(int signal_number) {
    (void)signal_number;
    if (getppid() != parent) _exit(1);
}

__attribute__((constructor)) static void start(void) {
    const char *number = getenv("LOCKSTEP_SOCKET");
    if (!number) return;
    lockstep_socket = atoi(number);
    parent = getppid();
    struct sigaction action = {.sa_handler = check_parent, .sa_flags = SA_RESTART};
    sigaction(SIGALRM, &action, NULL);
    struct itimerval timer = {{CHECK_INTERVAL, 0}, {CHECK_INTERVAL, 0}};
    setitimer(ITIMER_REAL, &timer, NULL);
    signal(SIGINT, SIG_IGN); /* the parent decides when to stop */
}

/* Coroutines */

static void run_worker(int index) {
    workers[index].function(workers[index].argument);
    for (;;) swapcontext(&workers[index].context, &main_context);
}

static void resume(worker_t *worker) {
    current = worker;
    swapcontext(&main_context, &worker->context);
    current = NULL;
}

static void yield_to_main(void) { swapcontext(&current->context, &main_context); }

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*function)(void *), void *argument) {
    (void)attributes;
    if (num_workers == MAX_WORKERS) return EAGAIN;
    worker_t *worker = &workers[num_workers];
    worker->function = function;
    worker->argument = argument;
    getcontext(&worker->context);
    worker->context.uc_stack.ss_sp = malloc(STACK_SIZE);
    worker->context.uc_stack.ss_size = STACK_SIZE;
    makecontext(&worker->context, (void (*)(void))run_worker, 1, num_workers);
    *thread = (pthread_t)num_workers++;
    resume(worker); /* until it waits for the first time */
    return 0;
}

int pthread_join(pthread_t thread, void **result) {
    (void)thread, (void)result;
    return 0;
}

/* Clock */

static uint32_t *pending(int port) { return port == STATE_PORT ? &request.has_state : &request.has_channels; }

static int has_work(const worker_t *worker) {
    return worker->port ? *pending(worker->port) != 0 : request.runs_serial != 0;
}

static void exchange(void) {
    reply.now = now;
    if (send(lockstep_socket, &reply, sizeof reply, 0) != sizeof reply) _exit(1);
    reply.num_updates = 0;
    ssize_t size;
    do size = recv(lockstep_socket, &request, sizeof request, 0);
    while (size < 0 && errno == EINTR);
    if (size != sizeof request) _exit(0);
    for (int i = 0; i < num_workers; i++)
        if (has_work(&workers[i])) resume(&workers[i]);
}

int nanosleep(const struct timespec *duration, struct timespec *rest) {
    (void)rest;
    if (current) {
        yield_to_main();
        return 0;
    }
    if (duration->tv_sec == 0 && duration->tv_nsec == LOOP_SLEEP) reply.is_running = 1;
    now += (uint64_t)duration->tv_sec * 1000000000ull + (uint64_t)duration->tv_nsec;
    while (now >= request.until) exchange();
    return 0;
}

int clock_gettime(clockid_t id, struct timespec *time) {
    (void)id;
    now += READING_TIME;
    time->tv_sec = (time_t)(now / 1000000000ull);
    time->tv_nsec = (long)(now % 1000000000ull);
    return 0;
}

int gettimeofday(struct timeval *restrict time, void *restrict zone) {
    (void)zone;
    time->tv_sec = (time_t)(now / 1000000000ull);
    time->tv_usec = (suseconds_t)(now % 1000000000ull / 1000);
    return 0;
}

time_t time(time_t *result) {
    time_t seconds = (time_t)(now / 1000000000ull);
    if (result) *result = seconds;
    return seconds;
}

/* Sockets */

static int port_of_address(const struct sockaddr *address) {
    return ntohs(((const struct sockaddr_in *)address)->sin_port); /* at the same place for IPv4 and IPv6 */
}

int socket(int domain, int type, int protocol) {
    (void)domain, (void)protocol;
    return (int)syscall(SYS_socket, AF_UNIX, type, 0);
}

static int bind_to_file(int file, int port) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    snprintf(address.sun_path, sizeof address.sun_path, "serial_%d", port);
    return (int)syscall(SYS_bind, file, &address, sizeof address);
}

int bind(int file, const struct sockaddr *address, socklen_t size) {
    (void)size;
    int type = 0;
    socklen_t length = sizeof type;
    getsockopt(file, SOL_SOCKET, SO_TYPE, &type, &length);
    if (type != SOCK_DGRAM) return bind_to_file(file, port_of_address(address));
    if (file >= 0 && file < MAX_FILES) port_of_file[file] = port_of_address(address);
    return 0;
}

ssize_t sendto(int file, const void *data, size_t size, int flags, const struct sockaddr *address, socklen_t length) {
    (void)file, (void)flags, (void)length;
    if (port_of_address(address) == MOTOR_PORT && size >= sizeof reply.motors) {
        memcpy(reply.motors, data, sizeof reply.motors);
        reply.num_updates++;
    }
    return (ssize_t)size;
}

/* Return the number of the port of the only datagram socket in a set; 0 if the set contains other files. */
static int datagram_port(int size, const fd_set *files) {
    if (!files) return 0;
    for (int file = 0; file < size; file++)
        if (FD_ISSET(file, files) && file < MAX_FILES && port_of_file[file]) return port_of_file[file];
    return 0;
}

int select(int size, fd_set *restrict readable, fd_set *restrict writable, fd_set *restrict failed,
           struct timeval *restrict timeout) {
    (void)timeout;
    int port = datagram_port(size, readable);
    if (current) {
        current->port = port;
        yield_to_main();
    }
    if (port) return *pending(port) ? 1 : 0;
    struct timespec none = {0, 0};
    return (int)syscall(SYS_pselect6, size, readable, writable, failed, &none, NULL);
}

ssize_t recvfrom(int file, void *restrict data, size_t size, int flags, struct sockaddr *restrict address,
                 socklen_t *restrict length) {
    (void)flags, (void)address, (void)length;
    int port = file < MAX_FILES ? port_of_file[file] : 0;
    const void *packet = port == STATE_PORT ? (const void *)&request.state : (const void *)&request.channels;
    size_t available = port == STATE_PORT ? sizeof request.state : sizeof request.channels;
    if (!port || size < available) return -1;
    memcpy(data, packet, available);
    *pending(port) = 0;
    return (ssize_t)available;
}
