/*
 * Sensors and motors of the board: complete this file for your board.
 *
 * Units are SI units, and angles are in radians. The world frame has Z up. The body frame has x forward, y left and z up.
 */
#include <Arduino.h>

#include "board.h"

void start_board(void)
{
    Serial.begin(115200);
}

bool read_inputs(@NAME@_inputs_t *inputs)
{
    (void)inputs; /* set inputs->@MEASUREMENT@ from your estimator, and the reference from your pilot or plan */
    return false;
}

void write_outputs(const @NAME@_outputs_t *outputs)
{
    (void)outputs; /* convert the outputs to commands of your motors */
}

void stop_motors(void)
{
}

void report_late_step(uint32_t num_late_steps)
{
    Serial.println(num_late_steps);
}
