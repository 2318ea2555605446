// Board of the Arduino project: a clock, and memory in place of sensors and motors.
#include <string.h>

#include "arduino.h"
#include HEADER

StubSerial Serial;

static uint32_t now;
static const void *sensors;
static void *motors;
static bool armed, stopped;
static uint32_t late_steps;

uint32_t micros() { return now; }
void start_board(void) {}
bool read_inputs(INPUTS *inputs)
{
    if (armed)
        memcpy(inputs, sensors, sizeof(*inputs));
    return armed;
}
void write_outputs(const OUTPUTS *outputs)
{
    stopped = false;
    memcpy(motors, outputs, sizeof(*outputs));
}
void stop_motors(void) { stopped = true; }
void report_late_step(uint32_t num_late_steps) { late_steps = num_late_steps; }

extern "C" void start(uint32_t microseconds)
{
    now = microseconds;
    setup();
}

extern "C" void arm(bool value) { armed = value; }
extern "C" bool has_stopped() { return stopped; }
extern "C" uint32_t num_late_steps() { return late_steps; }

extern "C" void run(uint32_t microseconds, const void *inputs, void *outputs)
{
    now = microseconds;
    sensors = inputs;
    motors = outputs;
    loop();
}
