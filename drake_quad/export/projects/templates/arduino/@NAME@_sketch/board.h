/* Sensors and motors of the board. */
#ifndef BOARD_H
#define BOARD_H

#include "@NAME@.h"

/* Start sensors and motors. */
void start_board(void);

/* Set the inputs of the controller. Return false if the vehicle must not fly, for example because the pilot has disarmed
 * it or because a sensor has failed. */
bool read_inputs(@NAME@_inputs_t *inputs);

/* Send the outputs of the controller to the motors. */
void write_outputs(const @NAME@_outputs_t *outputs);

/* Stop all motors. */
void stop_motors(void);

/* Report that a step began at least one period late. */
void report_late_step(uint32_t num_late_steps);

#endif
