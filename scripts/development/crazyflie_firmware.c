/* Runs the PID controller of a checkout of crazyflie-firmware on recorded inputs, for record_crazyflie_firmware.py.
 *
 * This file contains no code of the firmware. It includes the firmware's files from the checkout, so that their static
 * variables can be read. Headers that need the hardware, logging or parameters are replaced by empty ones.
 */
#include "controller_pid.c"
#include "position_controller_pid.c"
#undef DT
#include "attitude_pid_controller.c"
#include "power_distribution_quadrotor.c"

enum { NUM_INPUTS = 16, NUM_OUTPUTS = 14 };

/* Sets the parameters of tests/design/crazyflie_tuned.txt, in their order. */
void tune(const float *p) {
  this.pidX.pid.kd = p[0];
  this.pidVX.pid.kd = p[1], this.pidVX.pid.kff = p[2];
  pidRoll.kd = p[3], pidRoll.kff = p[4];
  pidRollRate.kff = p[5];
  attFiltEnable = p[6], rateFiltEnable = p[7];
}

static float output_of(const PidObject *pid) { return pid->outP + pid->outI + pid->outD + pid->outFF; }

/* Each row of the inputs: position, velocity, roll, pitch, yaw, gyroscope, position and yaw of the setpoint. */
void run(int count, const float *in, float *out) {
  static state_t state;
  static setpoint_t setpoint;
  static sensorData_t sensors;
  static control_t control;
  controllerPidInit();
  setpoint.mode.x = setpoint.mode.y = setpoint.mode.z = setpoint.mode.yaw = modeAbs;
  for (int k = 0; k < count; k++, in += NUM_INPUTS, out += NUM_OUTPUTS) {
    state.position.x = in[0], state.position.y = in[1], state.position.z = in[2];
    state.velocity.x = in[3], state.velocity.y = in[4], state.velocity.z = in[5];
    state.attitude.roll = in[6], state.attitude.pitch = in[7], state.attitude.yaw = in[8];
    sensors.gyro.x = in[9], sensors.gyro.y = in[10], sensors.gyro.z = in[11];
    setpoint.position.x = in[12], setpoint.position.y = in[13], setpoint.position.z = in[14];
    setpoint.attitude.yaw = in[15];
    /* The stabilizer runs at 1 kHz, the attitude at every second step, the position at every tenth. */
    controllerPid(&control, &setpoint, &sensors, &state, 2 * k);
    motors_thrust_uncapped_t motors;
    powerDistribution(&control, &motors);
    const float row[NUM_OUTPUTS] = {
        attitudeDesired.roll, attitudeDesired.pitch, attitudeDesired.yaw, actuatorThrust,
        rateDesired.roll, rateDesired.pitch, rateDesired.yaw,
        output_of(&pidRollRate), output_of(&pidPitchRate), output_of(&pidYawRate),
        motors.motors.m1, motors.motors.m2, motors.motors.m3, motors.motors.m4};
    for (int i = 0; i < NUM_OUTPUTS; i++) out[i] = row[i];
  }
}
