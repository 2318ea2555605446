/* Declarations of ROS 2 that the project uses, written from its published interface. */
#pragma once
#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

template <class Message> inline std::function<void(std::shared_ptr<const Message>)> stub_callback;
template <class Message> inline Message stub_published;
inline unsigned stub_num_commands = 0;
inline std::function<void()> stub_timer;
inline std::chrono::microseconds stub_period;
inline std::shared_ptr<void> stub_node;
inline double stub_now = 0.0;

namespace rclcpp {
struct QoS {
    explicit QoS(int) {}
    QoS() = default;
};
struct SensorDataQoS : QoS {};
struct Duration {
    double value;
    double seconds() const { return value; }
};
struct Time {
    double value = 0.0;
    Duration operator-(const Time &other) const { return {value - other.value}; }
};
struct TimerBase {
    using SharedPtr = std::shared_ptr<TimerBase>;
};
template <class Message> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    void publish(const Message &message)
    {
        stub_published<Message> = message;
        stub_num_commands += 1;
    }
};
template <class Message> struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription>;
};
class Node {
public:
    explicit Node(const std::string &) {}
    double declare_parameter(const std::string &, double value) { return value; }
    Time now() const { return {stub_now}; }
    template <class Message> typename Publisher<Message>::SharedPtr create_publisher(const std::string &, const QoS &)
    {
        return std::make_shared<Publisher<Message>>();
    }
    template <class Message, class Callback>
    typename Subscription<Message>::SharedPtr create_subscription(const std::string &, const QoS &, Callback callback)
    {
        stub_callback<Message> = callback;
        return std::make_shared<Subscription<Message>>();
    }
    std::shared_ptr<int> get_clock() const { return nullptr; }
};
template <class Callback>
TimerBase::SharedPtr create_timer(Node *, std::shared_ptr<int>, std::chrono::microseconds period, Callback callback)
{
    stub_period = period;
    stub_timer = callback;
    return std::make_shared<TimerBase>();
}
inline void init(int, char **) {}
template <class T> void spin(std::shared_ptr<T> node) { stub_node = node; }
inline void shutdown() {}
} // namespace rclcpp

namespace geometry_msgs::msg {
struct Vector3 {
    double x = 0, y = 0, z = 0;
};
struct Quaternion {
    double x = 0, y = 0, z = 0, w = 1;
};
struct Twist {
    Vector3 linear, angular;
};
struct Transform {
    Vector3 translation;
    Quaternion rotation;
};
struct Wrench {
    Vector3 force, torque;
};
struct Header {
    rclcpp::Time stamp;
    std::string frame_id;
};
struct WrenchStamped {
    Header header;
    Wrench wrench;
};
} // namespace geometry_msgs::msg

namespace nav_msgs::msg {
struct Odometry {
    using ConstSharedPtr = std::shared_ptr<const Odometry>;
    struct {
        struct {
            geometry_msgs::msg::Vector3 position;
            geometry_msgs::msg::Quaternion orientation;
        } pose;
    } pose;
    struct {
        geometry_msgs::msg::Twist twist;
    } twist;
};
} // namespace nav_msgs::msg

namespace trajectory_msgs::msg {
struct MultiDOFJointTrajectoryPoint {
    using ConstSharedPtr = std::shared_ptr<const MultiDOFJointTrajectoryPoint>;
    std::vector<geometry_msgs::msg::Transform> transforms;
    std::vector<geometry_msgs::msg::Twist> velocities, accelerations;
};
} // namespace trajectory_msgs::msg

namespace mavros_msgs::msg {
struct AttitudeTarget {
    static constexpr unsigned char IGNORE_ROLL_RATE = 1, IGNORE_PITCH_RATE = 2, IGNORE_YAW_RATE = 4;
    geometry_msgs::msg::Header header;
    unsigned char type_mask = 0;
    geometry_msgs::msg::Quaternion orientation;
    float thrust = 0;
};
} // namespace mavros_msgs::msg
