/*
 * Controller of the scenario @SCENARIO@ as an out-of-tree controller for the Crazyflie firmware.
 *
 * The firmware measures angles in degrees, and this file converts them. The attitude is taken from the quaternion, since
 * the pitch angle of the firmware has the opposite sign. The firmware's world frame has Z up, and its body frame has x
 * forward, y left and z up, as in drake_quad. The command is a thrust in N and torques in N m, for a vehicle of
 * @MASS@ kg.
 */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "FreeRTOS.h"
#include "app.h"
#include "controller.h"
#include "task.h"

#include "@NAME@.h"

static const float radians_per_degree = 0.017453293f;
/* Number of calls of the firmware, which come every millisecond, in a period of the controller. */
static const uint32_t calls_per_step = @CALLS@;

static @NAME@_t controller_state;
static @NAME@_outputs_t outputs;
/* Step of the firmware at which the setpoint enabled the motors. */
static stabilizerStep_t first_step;
static bool flying;

/* The firmware requires a task for the app. This task does nothing. */
void appMain(void)
{
    for (;;)
        vTaskDelay(M2T(1000));
}

void controllerOutOfTreeInit(void)
{
    @NAME@_init(&controller_state);
}

bool controllerOutOfTreeTest(void)
{
    return true;
}

static float yaw_of(const quaternion_t *q)
{
    return atan2f(2.0f * (q->w * q->z + q->x * q->y), 1.0f - 2.0f * (q->y * q->y + q->z * q->z));
}

static @NAME@_state_t measurement_of(const state_t *state, const sensorData_t *sensors)
{
    const quaternion_t *q = &state->attitudeQuaternion;
    const float sin_pitch = 2.0f * (q->w * q->y - q->z * q->x);
    const @NAME@_state_t measurement = {
        .x = state->position.x,
        .y = state->position.y,
        .z = state->position.z,
        .roll = atan2f(2.0f * (q->w * q->x + q->y * q->z), 1.0f - 2.0f * (q->x * q->x + q->y * q->y)),
        .pitch = asinf(fmaxf(-1.0f, fminf(1.0f, sin_pitch))),
        .yaw = yaw_of(q),
        .v_x = state->velocity.x,
        .v_y = state->velocity.y,
        .v_z = state->velocity.z,
        .p = sensors->gyro.x * radians_per_degree,
        .q = sensors->gyro.y * radians_per_degree,
        .r = sensors->gyro.z * radians_per_degree,
    };
    return measurement;
}

static float commanded_yaw(const setpoint_t *setpoint, const state_t *state)
{
    if (setpoint->mode.quat == modeAbs)
        return yaw_of(&setpoint->attitudeQuaternion);
    if (setpoint->mode.yaw == modeAbs)
        return setpoint->attitude.yaw * radians_per_degree;
    return yaw_of(&state->attitudeQuaternion);
}

/* An axis without a position setpoint stays where it is, and moves with the velocity setpoint if there is one. */
static float position_or(stab_mode_t mode, float setpoint, float measured)
{
    return mode == modeAbs ? setpoint : measured;
}

static @NAME@_inputs_t inputs_of(const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state)
{
    float v_x = setpoint->mode.x == modeDisable ? 0.0f : setpoint->velocity.x;
    float v_y = setpoint->mode.y == modeDisable ? 0.0f : setpoint->velocity.y;
    if (setpoint->velocity_body) {
        const float yaw = yaw_of(&state->attitudeQuaternion), forward = v_x, left = v_y;
        v_x = cosf(yaw) * forward - sinf(yaw) * left;
        v_y = sinf(yaw) * forward + cosf(yaw) * left;
    }
    const @NAME@_inputs_t inputs = {
        .@MEASUREMENT@ = measurement_of(state, sensors),
        .reference = {
            .x = position_or(setpoint->mode.x, setpoint->position.x, state->position.x),
            .y = position_or(setpoint->mode.y, setpoint->position.y, state->position.y),
            .z = position_or(setpoint->mode.z, setpoint->position.z, state->position.z),
            .v_x = v_x,
            .v_y = v_y,
            .v_z = setpoint->velocity.z,
            .a_x = setpoint->acceleration.x,
            .a_y = setpoint->acceleration.y,
            .a_z = setpoint->acceleration.z,
            .yaw = commanded_yaw(setpoint, state),
            .yaw_rate = setpoint->attitudeRate.yaw * radians_per_degree,
        },
        @JERK@
    };
    return inputs;
}

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
    const state_t *state, const stabilizerStep_t stabilizerStep)
{
    control->controlMode = controlModeForceTorque;
    if (setpoint->mode.z == modeDisable) {
        /* The motors are off, and the controller is reset for the next flight. */
        @NAME@_init(&controller_state);
        flying = false;
        control->thrustSi = 0.0f;
        control->torqueX = control->torqueY = control->torqueZ = 0.0f;
        return;
    }
    if (!flying)
        first_step = stabilizerStep;
    flying = true;
    if ((stabilizerStep - first_step) % calls_per_step == 0) {
        const @NAME@_inputs_t inputs = inputs_of(setpoint, sensors, state);
        @NAME@_step(&controller_state, &@NAME@_default_parameters, &inputs, &outputs);
    }
    control->thrustSi = outputs.wrench.thrust;
    control->torqueX = outputs.wrench.tau_x;
    control->torqueY = outputs.wrench.tau_y;
    control->torqueZ = outputs.wrench.tau_z;
}
