/* Program of an emulated board: it reads state and inputs of each step from a pipe, and writes outputs and state.

   The pipes are files of the host, which the program opens and uses by semihosting (Arm, "Semihosting for AArch32 and
   AArch64"). The timer SysTick counts the simulated time of a step. */
#include HEADER

enum { SYS_OPEN = 1, SYS_WRITE = 5, SYS_READ = 6, SYS_EXIT = 24 };
enum { READ_BINARY = 1, WRITE_BINARY = 5 };
enum { RUN_TIME_ERROR = 0x20023, APPLICATION_EXIT = 0x20026 }; /* reasons of SYS_EXIT */

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014)
#define SYSTICK_COUNT (*(volatile uint32_t *)0xE000E018)
#define COPROCESSOR_ACCESS (*(volatile uint32_t *)0xE000ED88)

extern uint32_t stack_top;
extern uint32_t zeros_begin, zeros_end;

static STATE_T state;
static INPUTS_T inputs;
static OUTPUTS_T outputs;

static uint32_t semihosting(uint32_t operation, const void *arguments)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static uint32_t open_file(const char *name, uint32_t length, uint32_t mode)
{
    const uint32_t arguments[3] = {(uint32_t)name, mode, length};
    return semihosting(SYS_OPEN, arguments);
}

static void stop(uint32_t reason)
{
    semihosting(SYS_EXIT, (const void *)reason);
    for (;;) {
    }
}

/* Transfer all bytes. The operations return the number of bytes that are left. If none was transferred, the process at
   the other end of the pipe has ended, and the program ends, too. */
static void transfer(uint32_t operation, uint32_t file, void *data, uint32_t size)
{
    uint32_t left = size;
    while (left > 0) {
        const uint32_t arguments[3] = {file, (uint32_t)data + size - left, left};
        const uint32_t before = left;
        left = semihosting(operation, arguments);
        if (left >= before)
            stop(APPLICATION_EXIT);
    }
}

static __attribute__((noinline)) void run(void)
{
    const uint32_t requests = open_file("requests", 8, READ_BINARY);
    const uint32_t responses = open_file("responses", 9, WRITE_BINARY);
    SYSTICK_RELOAD = 0xFFFFFF;
    SYSTICK_CONTROL = 5;
    for (;;) {
        transfer(SYS_READ, requests, &state, sizeof state);
        transfer(SYS_READ, requests, &inputs, sizeof inputs);
        const uint32_t begin = SYSTICK_COUNT;
        STEP(&state, &PARAMETERS, &inputs, &outputs);
        uint32_t duration = (begin - SYSTICK_COUNT) & 0xFFFFFF;
        transfer(SYS_WRITE, responses, &outputs, sizeof outputs);
        transfer(SYS_WRITE, responses, &state, sizeof state);
        transfer(SYS_WRITE, responses, &duration, sizeof duration);
    }
}

static void reset(void)
{
    COPROCESSOR_ACCESS |= 0xFu << 20; /* enables the floating-point unit */
    for (volatile uint32_t *word = &zeros_begin; word < &zeros_end; ++word)
        *word = 0;
    run();
}

static void fault(void)
{
    stop(RUN_TIME_ERROR);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)fault, (const void *)fault,
    (const void *)fault, (const void *)fault, (const void *)fault,
};
