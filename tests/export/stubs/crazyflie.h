/* Declarations of the Crazyflie's firmware that the project uses, written from its published interface. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

#define M2T(milliseconds) ((uint32_t)(milliseconds))

typedef uint32_t stabilizerStep_t;
typedef struct { float x, y, z; } Axis3f;
typedef struct { uint32_t timestamp; float roll, pitch, yaw; } attitude_t;
typedef struct { uint32_t timestamp; float x, y, z; } point_t;
typedef point_t velocity_t;
typedef point_t acc_t;
typedef point_t jerk_t;
typedef struct { float x, y, z, w; } quaternion_t;
typedef struct { Axis3f acc, gyro; } sensorData_t;
typedef struct {
    attitude_t attitude;
    quaternion_t attitudeQuaternion;
    point_t position;
    velocity_t velocity;
    acc_t acc;
} state_t;
typedef enum { controlModeLegacy, controlModeForceTorque, controlModeForce } control_mode_t;
typedef struct {
    float thrustSi, torqueX, torqueY, torqueZ;
    control_mode_t controlMode;
} control_t;
typedef enum { modeDisable, modeAbs, modeVelocity } stab_mode_t;
typedef struct { stab_mode_t x, y, z, roll, pitch, yaw, quat; } setpoint_mode_t;
typedef struct {
    attitude_t attitude, attitudeRate;
    quaternion_t attitudeQuaternion;
    point_t position;
    velocity_t velocity;
    acc_t acceleration;
    jerk_t jerk;
    bool velocity_body;
    setpoint_mode_t mode;
} setpoint_t;

void controllerOutOfTreeInit(void);
bool controllerOutOfTreeTest(void);
void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
    const state_t *state, const stabilizerStep_t stabilizerStep);
void appMain(void);
void vTaskDelay(uint32_t ticks);
