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

// Inputs: position, velocity, quaternion w x y z, body rates, and the trajectory setpoint.
// Command: thrust and torque, or quaternion, thrust and yaw rate.
extern "C" void step(uint64_t microseconds, const double *inputs, double *command)
{
	stub_now = microseconds;
	vehicle_local_position_s position{stub_now, stub_now, true, true, true, true, 0, 0, 0, 0, 0, 0};
	vehicle_attitude_s attitude{stub_now, stub_now, {}};
	vehicle_angular_velocity_s rates{stub_now, stub_now, {}};
	trajectory_setpoint_s setpoint{};
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
