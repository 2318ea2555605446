// Sends messages to the project for ROS 2, calls its timer, and reads the command that it publishes.
#include "ros2.hpp"

int node_main(int argc, char **argv); // main of the node, renamed by the compiler

extern "C" unsigned start()
{
    node_main(0, nullptr);
    return unsigned(stub_period.count());
}

extern "C" unsigned num_commands() { return stub_num_commands; }

extern "C" void send_odometry(const double *inputs)
{
    nav_msgs::msg::Odometry odometry;
    auto &pose = odometry.pose.pose;
    auto &twist = odometry.twist.twist;
    pose.position = {inputs[0], inputs[1], inputs[2]};
    twist.linear = {inputs[3], inputs[4], inputs[5]};
    pose.orientation = {inputs[7], inputs[8], inputs[9], inputs[6]};
    twist.angular = {inputs[10], inputs[11], inputs[12]};
    stub_callback<nav_msgs::msg::Odometry>(std::make_shared<const nav_msgs::msg::Odometry>(odometry));
}

// Let time pass without odometry.
extern "C" void tick(uint64_t microseconds)
{
    stub_now = 1e-6 * double(microseconds);
    stub_timer();
}

// Read the latest command: wrench, or quaternion and thrust.
extern "C" void read_command(double *command)
{
    const auto &wrench = stub_published<geometry_msgs::msg::WrenchStamped>.wrench;
    const auto &target = stub_published<mavros_msgs::msg::AttitudeTarget>;
#if COMMANDS_ATTITUDE
    (void)wrench;
    const auto &q = target.orientation;
    const double values[5] = {q.w, q.x, q.y, q.z, target.thrust};
#else
    (void)target;
    const double values[4] = {wrench.force.z, wrench.torque.x, wrench.torque.y, wrench.torque.z};
#endif
    for (double value : values)
        *command++ = value;
}

// Inputs: position, velocity in the body frame, quaternion w x y z, body rates; position, velocity, acceleration,
// quaternion and yaw rate of the reference.
extern "C" void step(uint64_t microseconds, const double *inputs, double *command)
{
    stub_now = 1e-6 * double(microseconds);
    send_odometry(inputs);
    const double *r = inputs + 13;
    trajectory_msgs::msg::MultiDOFJointTrajectoryPoint point;
    point.transforms = {{{r[0], r[1], r[2]}, {r[10], r[11], r[12], r[9]}}};
    point.velocities = {{{r[3], r[4], r[5]}, {0, 0, r[13]}}};
    point.accelerations = {{{r[6], r[7], r[8]}, {}}};
    using Point = trajectory_msgs::msg::MultiDOFJointTrajectoryPoint;
    stub_callback<Point>(std::make_shared<const Point>(point));
    stub_timer();
    read_command(command);
}
