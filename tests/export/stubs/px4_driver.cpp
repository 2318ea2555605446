// Sets the topics that the project for PX4 reads, runs the module, and reads the topics that it publishes.
#include "px4.hpp"

extern "C" int NAME_main(int argc, char *argv[]);

namespace
{
template<class T> void publish(const T &message)
{
	stub_topic<T>.message = message;
	stub_topic<T>.publications += 1;
}

template<int count> void take(float (&target)[count], const double *&source)
{
	for (float &element : target) { element = float(*source++); }
}
}

extern "C" uint32_t start(float hover_thrust)
{
	stub_hover_thrust = hover_thrust;
	NAME_main(0, nullptr);
	return stub_interval;
}

// Set whether the vehicle is armed in Offboard mode.
extern "C" void engage(bool engaged) { publish(vehicle_control_mode_s{stub_now, true, engaged}); }

// Return the number of commands so far.
extern "C" unsigned num_commands()
{
	return stub_topic<vehicle_attitude_setpoint_s>.publications + stub_topic<vehicle_thrust_setpoint_s>.publications;
}

// Return whether PX4 is asked to accept commands of an attitude (1) or of thrust and torques (2), at the present time.
extern "C" int offboard_request()
{
	const auto &request = stub_topic<offboard_control_mode_s>.message;
	const bool others = request.position || request.velocity || request.acceleration || request.body_rate
			    || request.direct_actuator;
	return request.timestamp != stub_now || others ? 0 : int(request.attitude) + 2 * int(request.thrust_and_torque);
}

// Return whether the latest commands have the present time, and the time of the latest body rates.
extern "C" bool has_current_times()
{
	const auto &attitude = stub_topic<vehicle_attitude_setpoint_s>;
	const auto &thrust = stub_topic<vehicle_thrust_setpoint_s>;
	const auto &torque = stub_topic<vehicle_torque_setpoint_s>.message;

	if (attitude.publications) { return attitude.message.timestamp == stub_now; }

	const uint64_t sample = stub_topic<vehicle_angular_velocity_s>.message.timestamp_sample;
	return thrust.message.timestamp == stub_now && torque.timestamp == stub_now
	       && thrust.message.timestamp_sample == sample && torque.timestamp_sample == sample;
}

// Set the age of the estimates of the next steps in microseconds, and whether each of four parts of the position is valid.
static uint64_t ages[3], setpoint_age;
extern "C" void set_setpoint_age(uint64_t age) { setpoint_age = age; }
static bool valid[4] = {true, true, true, true};
extern "C" void degrade(const uint64_t *estimate_ages, const bool *valid_parts)
{
	memcpy(ages, estimate_ages, sizeof(ages));
	memcpy(valid, valid_parts, sizeof(valid));
}

// Inputs: position, velocity, quaternion w x y z, body rates, and the trajectory setpoint.
// Command: thrust and torque, or quaternion, thrust and yaw rate.
extern "C" void step(uint64_t microseconds, const double *inputs, double *command)
{
	stub_now = microseconds;
	vehicle_local_position_s position{stub_now - ages[0], stub_now, valid[0], valid[1], valid[2], valid[3], 0, 0, 0, 0, 0, 0};
	vehicle_attitude_s attitude{stub_now - ages[1], stub_now, {}};
	vehicle_angular_velocity_s rates{stub_now - ages[2], stub_now, {}};
	trajectory_setpoint_s setpoint{};
	setpoint.timestamp = stub_now - setpoint_age;
	float place[3], velocity[3];
	take(place, inputs);
	take(velocity, inputs);
	take(attitude.q, inputs);
	take(rates.xyz, inputs);
	take(setpoint.position, inputs);
	take(setpoint.velocity, inputs);
	take(setpoint.acceleration, inputs);
	take(setpoint.jerk, inputs);
	setpoint.yaw = float(inputs[0]);
	setpoint.yawspeed = float(inputs[1]);
	position.x = place[0], position.y = place[1], position.z = place[2];
	position.vx = velocity[0], position.vy = velocity[1], position.vz = velocity[2];
	publish(position);
	publish(attitude);
	publish(rates);
	publish(setpoint);
	stub_item->Run();

	if (stub_topic<vehicle_attitude_setpoint_s>.publications) {
		const auto &target = stub_topic<vehicle_attitude_setpoint_s>.message;

		for (int i = 0; i < 4; ++i) { command[i] = double(target.q_d[i]); }

		command[4] = double(target.thrust_body[2]);
		command[5] = double(target.yaw_sp_move_rate);

	} else {
		command[0] = double(stub_topic<vehicle_thrust_setpoint_s>.message.xyz[2]);

		for (int i = 0; i < 3; ++i) { command[i + 1] = double(stub_topic<vehicle_torque_setpoint_s>.message.xyz[i]); }
	}
}
