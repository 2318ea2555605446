/*
 * Controller of the scenario @SCENARIO@ on a microcontroller without an operating system.
 *
 * The loop calls the controller at its period. Sensors and motors are in board.cpp, which you complete for your board.
 */
#include <Arduino.h>

#include "@NAME@.h"
#include "board.h"

static const uint32_t period_us = @MICROSECONDS@;

static @NAME@_t controller;
static @NAME@_inputs_t inputs;
static @NAME@_outputs_t outputs;
static uint32_t next_step_us;
static uint32_t num_late_steps;
static bool flying;

void setup()
{
    start_board();
    next_step_us = micros();
}

void loop()
{
    /* The difference of unsigned numbers stays correct when the clock overflows after 71 minutes. */
    const uint32_t lateness_us = micros() - next_step_us;
    if (lateness_us > UINT32_MAX / 2)
        return;
    next_step_us += period_us;
    if (lateness_us >= period_us) {
        num_late_steps += 1;
        report_late_step(num_late_steps);
        next_step_us = micros() + period_us;
    }
    if (!read_inputs(&inputs)) {
        /* Stop the motors. The controller is reset when the next flight begins. */
        stop_motors();
        flying = false;
        return;
    }
    if (!flying)
        @NAME@_init(&controller);
    flying = true;
#if @HAS_REFERENCE@
    @NAME@_reference(controller.step * (float)@NAME_UPPER@_PERIOD, &inputs);
#endif
    @NAME@_step(&controller, &@NAME@_default_parameters, &inputs, &outputs);
    write_outputs(&outputs);
}
