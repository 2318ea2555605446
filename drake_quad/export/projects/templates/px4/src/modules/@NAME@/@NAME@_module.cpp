/*
 * Controller of the scenario @SCENARIO@ as a module of PX4 (versions 1.14 to 1.16).
 *
 * The module commands @COMMAND@ in Offboard mode. In all other modes, PX4's own controllers fly, so the pilot
 * takes over by leaving Offboard mode. PX4 also leaves it if this module stops.
 *
 * PX4's frames are north, east, down and forward, right, down. The frames of the controller are north, west, up and
 * forward, left, up: half a turn about x changes the signs of y and z, of pitch and yaw, and of the rates about y and z.
 */
#include <math.h>
#include <string.h>

#include <drivers/drv_hrt.h>
#include <parameters/param.h>
#include <px4_platform_common/defines.h>
#include <px4_platform_common/log.h>
#include <px4_platform_common/module.h>
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/topics/offboard_control_mode.h>
#include <uORB/topics/trajectory_setpoint.h>
#include <uORB/topics/vehicle_angular_velocity.h>
#include <uORB/topics/vehicle_attitude.h>
#include <uORB/topics/vehicle_attitude_setpoint.h>
#include <uORB/topics/vehicle_control_mode.h>
#include <uORB/topics/vehicle_local_position.h>
#include <uORB/topics/vehicle_thrust_setpoint.h>
#include <uORB/topics/vehicle_torque_setpoint.h>

#include "@NAME@.h"

namespace
{
constexpr uint32_t period_us = @MICROSECONDS@;
/* Weight of the nominal vehicle, N. PX4 flies it with a normalised thrust of MPC_THR_HOVER. */
constexpr float weight = @WEIGHT@f;
/* Torques about x, y and z for a normalised torque of 1, if MPC_THR_HOVER were 1, N m. They follow from the nominal
 * rotors and the normalisation in ControlAllocationPseudoInverse. */
constexpr float torque_units[3] = {@TORQUE_X@f, @TORQUE_Y@f, @TORQUE_Z@f};
/* Age at which an estimate is too old to fly with, us. */
constexpr hrt_abstime max_age_us = 200000;
#if !@HAS_REFERENCE@
/* Age at which a trajectory setpoint is too old to follow, us. */
constexpr hrt_abstime max_setpoint_age_us = 500000;
#endif

float limited(float value, float low, float high)
{
	return fmaxf(low, fminf(high, value));
}

#if !@HAS_REFERENCE@
float finite_or(float value, float replacement)
{
	return isfinite(value) ? value : replacement;
}
#endif

float yaw_of(const float q[4])
{
	return atan2f(2.0f * (q[0] * q[3] + q[1] * q[2]), 1.0f - 2.0f * (q[2] * q[2] + q[3] * q[3]));
}
}

class @CLASS@ : public ModuleBase<@CLASS@>, public px4::ScheduledWorkItem
{
public:
	@CLASS@() : ScheduledWorkItem(MODULE_NAME, px4::wq_configurations::nav_and_controllers) {}

	static int task_spawn(int, char *[]);
	static int custom_command(int, char *[]) { return print_usage("unknown command"); }
	static int print_usage(const char *reason = nullptr);

private:
	void Run() override;
	bool read_measurement(hrt_abstime now);
	void set_reference(hrt_abstime now);
	void hold_place();
	void publish(hrt_abstime now);

	uORB::Subscription _angular_velocity_sub{ORB_ID(vehicle_angular_velocity)};
	uORB::Subscription _attitude_sub{ORB_ID(vehicle_attitude)};
	uORB::Subscription _control_mode_sub{ORB_ID(vehicle_control_mode)};
	uORB::Subscription _position_sub{ORB_ID(vehicle_local_position)};
	uORB::Subscription _setpoint_sub{ORB_ID(trajectory_setpoint)};
	uORB::Publication<offboard_control_mode_s> _offboard_pub{ORB_ID(offboard_control_mode)};
#if @COMMANDS_ATTITUDE@
	uORB::Publication<vehicle_attitude_setpoint_s> _attitude_pub{ORB_ID(vehicle_attitude_setpoint)};
#else
	uORB::Publication<vehicle_thrust_setpoint_s> _thrust_pub{ORB_ID(vehicle_thrust_setpoint)};
	uORB::Publication<vehicle_torque_setpoint_s> _torque_pub{ORB_ID(vehicle_torque_setpoint)};
#endif

	@NAME@_t _controller{};
	@NAME@_inputs_t _inputs{};
	@NAME@_outputs_t _outputs{};
	hrt_abstime _sample_time{0};
	float _hover_thrust{0.5f};
	bool _engaged{false};
	/* Position and yaw to hold if there is no setpoint, in the frames of the controller. */
	float _place[3] {};
	float _place_yaw{0.0f};
	hrt_abstime _engaged_at{0};
	bool _following{false};
};

void @CLASS@::Run()
{
	if (should_exit()) {
		ScheduleClear();
		exit_and_cleanup();
		return;
	}

	const hrt_abstime now = hrt_absolute_time();
	const bool measured = read_measurement(now);
	vehicle_control_mode_s mode{};
	_control_mode_sub.copy(&mode);

	if (measured) {
		/* PX4 accepts Offboard mode only while this message arrives. */
		offboard_control_mode_s offboard{};
		offboard.timestamp = now;
#if @COMMANDS_ATTITUDE@
		offboard.attitude = true;
#else
		offboard.thrust_and_torque = true;
#endif
		_offboard_pub.publish(offboard);
	}

	if (!measured || !mode.flag_armed || !mode.flag_control_offboard_enabled) {
		_engaged = false;
		return;
	}

	if (!_engaged) {
		/* The controller is reset whenever it is engaged. */
		@NAME@_init(&_controller);

		if (param_get(param_find("MPC_THR_HOVER"), &_hover_thrust) != 0) {
			return;
		}

		hold_place();
		_engaged_at = now;
		_engaged = true;
	}

	set_reference(now);
	@NAME@_step(&_controller, &@NAME@_default_parameters, &_inputs, &_outputs);
	publish(now);
}

/* Hold the present position and yaw from now on. */
void @CLASS@::hold_place()
{
	_place[0] = _inputs.@MEASUREMENT@.x;
	_place[1] = _inputs.@MEASUREMENT@.y;
	_place[2] = _inputs.@MEASUREMENT@.z;
	_place_yaw = _inputs.@MEASUREMENT@.yaw;
	_following = false;
}

/* Set the measured state. Return false if an estimate is missing, too old, or not a number. */
bool @CLASS@::read_measurement(hrt_abstime now)
{
	vehicle_local_position_s position{};
	vehicle_attitude_s attitude{};
	vehicle_angular_velocity_s rates{};

	if (!_position_sub.copy(&position) || !_attitude_sub.copy(&attitude) || !_angular_velocity_sub.copy(&rates)) {
		return false;
	}

	if (!position.xy_valid || !position.z_valid || !position.v_xy_valid || !position.v_z_valid
	    || now > position.timestamp + max_age_us || now > attitude.timestamp + max_age_us
	    || now > rates.timestamp + max_age_us) {
		return false;
	}

	const float *q = attitude.q;
	const float sin_pitch = fmaxf(-1.0f, fminf(1.0f, 2.0f * (q[0] * q[2] - q[3] * q[1])));
	_sample_time = rates.timestamp_sample;
	auto &measurement = _inputs.@MEASUREMENT@;
	measurement.x = position.x;
	measurement.y = -position.y;
	measurement.z = -position.z;
	measurement.roll = atan2f(2.0f * (q[0] * q[1] + q[2] * q[3]), 1.0f - 2.0f * (q[1] * q[1] + q[2] * q[2]));
	measurement.pitch = -asinf(sin_pitch);
	measurement.yaw = -yaw_of(q);
	measurement.v_x = position.vx;
	measurement.v_y = -position.vy;
	measurement.v_z = -position.vz;
	measurement.p = rates.xyz[0];
	measurement.q = -rates.xyz[1];
	measurement.r = -rates.xyz[2];
	return isfinite(measurement.x + measurement.y + measurement.z + measurement.v_x + measurement.v_y + measurement.v_z
			+ measurement.roll + measurement.pitch + measurement.yaw + measurement.p + measurement.q + measurement.r);
}

/* Set the reference. */
void @CLASS@::set_reference(hrt_abstime now)
{
	auto &reference = _inputs.reference;
#if @HAS_REFERENCE@
	/* The planned route, moved so that it begins where Offboard mode was engaged. Its yaw is that of the plan. */
	@NAME@_reference(0.0f, &_inputs);
	const float offset[3] = {_place[0] - reference.x, _place[1] - reference.y, _place[2] - reference.z};
	(void)now;
	@NAME@_reference((float)_controller.step * (float)@NAME_UPPER@_PERIOD, &_inputs);
	reference.x += offset[0];
	reference.y += offset[1];
	reference.z += offset[2];
#else
	/* The trajectory setpoint of a companion computer. PX4 itself publishes this topic in other modes, so setpoints from
	 * before Offboard mode are ignored. Without a recent setpoint, the vehicle holds its place. */
	trajectory_setpoint_s setpoint;
	const bool follows = _setpoint_sub.copy(&setpoint) && setpoint.timestamp >= _engaged_at
			     && now <= setpoint.timestamp + max_setpoint_age_us;

	if (_following && !follows) {
		hold_place();
	}

	_following = follows;

	if (!follows) {
		memset(&setpoint, 0xff, sizeof(setpoint)); /* all values are NaN */
	}

	reference.x = finite_or(setpoint.position[0], _place[0]);
	reference.y = finite_or(-setpoint.position[1], _place[1]);
	reference.z = finite_or(-setpoint.position[2], _place[2]);
	reference.v_x = finite_or(setpoint.velocity[0], 0.0f);
	reference.v_y = finite_or(-setpoint.velocity[1], 0.0f);
	reference.v_z = finite_or(-setpoint.velocity[2], 0.0f);
	reference.a_x = finite_or(setpoint.acceleration[0], 0.0f);
	reference.a_y = finite_or(-setpoint.acceleration[1], 0.0f);
	reference.a_z = finite_or(-setpoint.acceleration[2], 0.0f);
	reference.yaw = finite_or(-setpoint.yaw, _place_yaw);
	reference.yaw_rate = finite_or(-setpoint.yawspeed, 0.0f);
#if @HAS_JERK@
	_inputs.reference_jerk.x = finite_or(setpoint.jerk[0], 0.0f);
	_inputs.reference_jerk.y = finite_or(-setpoint.jerk[1], 0.0f);
	_inputs.reference_jerk.z = finite_or(-setpoint.jerk[2], 0.0f);
#endif
#endif
}

/* Publish the command. */
void @CLASS@::publish(hrt_abstime now)
{
#if @COMMANDS_ATTITUDE@
	const auto &target = _outputs.attitude_target;
	const float cr = cosf(0.5f * target.roll), sr = sinf(0.5f * target.roll);
	const float cp = cosf(0.5f * target.pitch), sp = -sinf(0.5f * target.pitch);
	const float cy = cosf(0.5f * target.yaw), sy = -sinf(0.5f * target.yaw);
	vehicle_attitude_setpoint_s attitude{};
	attitude.timestamp = now;
	attitude.yaw_sp_move_rate = -target.r;
	attitude.q_d[0] = cy * cp * cr + sy * sp * sr;
	attitude.q_d[1] = cy * cp * sr - sy * sp * cr;
	attitude.q_d[2] = cy * sp * cr + sy * cp * sr;
	attitude.q_d[3] = sy * cp * cr - cy * sp * sr;
	attitude.thrust_body[2] = limited(-_hover_thrust * target.thrust / weight, -1.0f, 0.0f);
	_attitude_pub.publish(attitude);
#else
	const auto &wrench = _outputs.wrench;
	vehicle_thrust_setpoint_s thrust{};
	thrust.timestamp = now;
	thrust.timestamp_sample = _sample_time;
	thrust.xyz[2] = limited(-_hover_thrust * wrench.thrust / weight, -1.0f, 0.0f);
	vehicle_torque_setpoint_s torque{};
	torque.timestamp = now;
	torque.timestamp_sample = _sample_time;
	torque.xyz[0] = limited(_hover_thrust * wrench.tau_x / torque_units[0], -1.0f, 1.0f);
	torque.xyz[1] = limited(-_hover_thrust * wrench.tau_y / torque_units[1], -1.0f, 1.0f);
	torque.xyz[2] = limited(-_hover_thrust * wrench.tau_z / torque_units[2], -1.0f, 1.0f);
	_torque_pub.publish(torque);
	_thrust_pub.publish(thrust);
#endif
}

int @CLASS@::task_spawn(int, char *[])
{
	@CLASS@ *instance = new @CLASS@();

	if (instance == nullptr) {
		PX4_ERR("out of memory");
		return PX4_ERROR;
	}

	_object.store(instance);
	_task_id = task_id_is_work_queue;
	instance->ScheduleOnInterval(period_us);
	return PX4_OK;
}

int @CLASS@::print_usage(const char *reason)
{
	if (reason) {
		PX4_WARN("%s\n", reason);
	}

	PRINT_MODULE_DESCRIPTION("Controller of the scenario @SCENARIO@, which flies in Offboard mode.");
	PRINT_MODULE_USAGE_NAME("@NAME@", "controller");
	PRINT_MODULE_USAGE_COMMAND("start");
	PRINT_MODULE_USAGE_DEFAULT_COMMANDS();
	return 0;
}

extern "C" __EXPORT int @NAME@_main(int argc, char *argv[])
{
	return @CLASS@::main(argc, argv);
}
