/* Declarations of PX4 that the project uses, written from its published interface. Topics are global variables. */
#pragma once
#include <stdint.h>
#include <string.h>

#define MODULE_NAME "module"
#define __EXPORT
#define PX4_OK 0
#define PX4_ERROR (-1)
#define PX4_ERR(...) (void)0
#define PX4_WARN(...) (void)reason
#define PRINT_MODULE_DESCRIPTION(text) (void)(text)
#define PRINT_MODULE_USAGE_NAME(name, category) (void)(name)
#define PRINT_MODULE_USAGE_COMMAND(name) (void)(name)
#define PRINT_MODULE_USAGE_DEFAULT_COMMANDS() (void)0

using hrt_abstime = uint64_t;
inline hrt_abstime stub_now = 0;
inline hrt_abstime hrt_absolute_time() { return stub_now; }

using param_t = uintptr_t;
inline float stub_hover_thrust = 0.5f;
inline param_t param_find(const char *name) { return strcmp(name, "MPC_THR_HOVER") == 0; }
inline int param_get(param_t parameter, void *value)
{
	if (parameter) { memcpy(value, &stub_hover_thrust, sizeof(float)); }

	return parameter ? 0 : -1;
}

struct offboard_control_mode_s {
	uint64_t timestamp;
	bool position, velocity, acceleration, attitude, body_rate, thrust_and_torque, direct_actuator;
};
struct trajectory_setpoint_s {
	uint64_t timestamp;
	float position[3], velocity[3], acceleration[3], jerk[3], yaw, yawspeed;
};
struct vehicle_angular_velocity_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_attitude_s { uint64_t timestamp, timestamp_sample; float q[4]; };
struct vehicle_attitude_setpoint_s { uint64_t timestamp; float yaw_sp_move_rate, q_d[4], thrust_body[3]; };
struct vehicle_control_mode_s { uint64_t timestamp; bool flag_armed, flag_control_offboard_enabled; };
struct vehicle_local_position_s {
	uint64_t timestamp, timestamp_sample;
	bool xy_valid, z_valid, v_xy_valid, v_z_valid;
	float x, y, z, vx, vy, vz;
};
struct vehicle_thrust_setpoint_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_torque_setpoint_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };

template<class T> struct StubTopic { T message{}; unsigned publications = 0; };
template<class T> inline StubTopic<T> stub_topic;
#define ORB_ID(name) (&stub_topic<name##_s>)

namespace uORB
{
class Subscription
{
public:
	template<class T> Subscription(StubTopic<T> *topic) : _topic(topic) {}
	template<class T> bool copy(T *message)
	{
		const auto *topic = static_cast<const StubTopic<T> *>(_topic);

		if (topic->publications) { *message = topic->message; }

		return topic->publications > 0;
	}

private:
	const void *_topic;
};

template<class T> class Publication
{
public:
	Publication(StubTopic<T> *topic) : _topic(topic) {}
	bool publish(const T &message)
	{
		_topic->message = message;
		_topic->publications += 1;
		return true;
	}

private:
	StubTopic<T> *_topic;
};
}

namespace px4
{
namespace wq_configurations { inline int nav_and_controllers = 0; }

class ScheduledWorkItem
{
public:
	ScheduledWorkItem(const char *, int) {}
	virtual ~ScheduledWorkItem() {}
	void ScheduleOnInterval(uint32_t interval_us);
	void ScheduleClear() {}
	virtual void Run() = 0;
};
}

inline px4::ScheduledWorkItem *stub_item = nullptr;
inline uint32_t stub_interval = 0;
inline void px4::ScheduledWorkItem::ScheduleOnInterval(uint32_t interval_us)
{
	stub_item = this;
	stub_interval = interval_us;
}

template<class T> class ModuleBase
{
public:
	static int main(int argc, char *argv[]) { return T::task_spawn(argc, argv); }

protected:
	struct Pointer { void store(T *) {} };
	static inline Pointer _object;
	static inline int _task_id = -1;
	static constexpr int task_id_is_work_queue = -2;
	bool should_exit() const { return false; }
	static void exit_and_cleanup() {}
};
