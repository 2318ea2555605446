/* Calls the project for the Crazyflie as its firmware does. */
#include <math.h>

#include "crazyflie.h"

static stab_mode_t xy_mode = modeAbs, z_mode = modeAbs, yaw_mode = modeAbs, quat_mode = modeDisable;
static bool velocity_is_in_body_frame;

void vTaskDelay(uint32_t ticks)
{
    (void)ticks;
}

void start(void)
{
    controllerOutOfTreeInit();
}

/* Set the modes of the setpoint. */
void set_modes(int z, int yaw, int quat)
{
    z_mode = (stab_mode_t)z;
    yaw_mode = (stab_mode_t)yaw;
    quat_mode = (stab_mode_t)quat;
}

/* Set the mode of x and y, and whether their velocity is in the body frame. */
void set_velocity_mode(int xy, bool in_body_frame)
{
    xy_mode = (stab_mode_t)xy;
    velocity_is_in_body_frame = in_body_frame;
}

/* inputs: position, velocity, quaternion x y z w, body rates, reference position, velocity, acceleration, jerk, yaw and
 * yaw rate, in the units of the firmware. */
void step(uint64_t microseconds, const double *inputs, double *command)
{
    static const state_t no_state;
    static const sensorData_t no_sensors;
    static const setpoint_t no_setpoint;
    state_t state = no_state;
    sensorData_t sensors = no_sensors;
    setpoint_t setpoint = no_setpoint;
    control_t control;
    const double *p = inputs;
#define POINT(target) (target).x = (float)p[0], (target).y = (float)p[1], (target).z = (float)p[2], p += 3
    POINT(state.position);
    POINT(state.velocity);
    POINT(state.attitudeQuaternion);
    state.attitudeQuaternion.w = (float)*p++;
    POINT(sensors.gyro);
    POINT(setpoint.position);
    POINT(setpoint.velocity);
    POINT(setpoint.acceleration);
    POINT(setpoint.jerk);
    if (yaw_mode == modeAbs)
        setpoint.attitude.yaw = (float)p[0];
    if (quat_mode == modeAbs) {
        const float half = (float)p[0] * 0.008726646f;
        setpoint.attitudeQuaternion.w = cosf(half);
        setpoint.attitudeQuaternion.z = sinf(half);
    }
    setpoint.attitudeRate.yaw = (float)p[1];
    setpoint.mode.x = setpoint.mode.y = xy_mode;
    setpoint.velocity_body = velocity_is_in_body_frame;
    setpoint.mode.z = z_mode;
    setpoint.mode.yaw = yaw_mode;
    setpoint.mode.quat = quat_mode;
    controllerOutOfTree(&control, &setpoint, &sensors, &state, (uint32_t)(microseconds / 1000));
    command[0] = control.thrustSi;
    command[1] = control.torqueX;
    command[2] = control.torqueY;
    command[3] = control.torqueZ;
}
