/*
 * Controller of the scenario @SCENARIO@ as a node of ROS 2.
 *
 * The node subscribes to the odometry of the vehicle, and publishes @COMMAND@ at the period of the controller.
 * Frames follow REP 103, as in the controller: the world frame has Z up, and the body frame has x forward, y left and z
 * up. The velocity of an odometry message is in the body frame; the node converts it.
 */
#include <chrono>
#include <cmath>
#include <memory>

#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <rclcpp/rclcpp.hpp>
#include <trajectory_msgs/msg/multi_dof_joint_trajectory_point.hpp>
#if @COMMANDS_ATTITUDE@
#include <mavros_msgs/msg/attitude_target.hpp>
#endif

#include "@NAME@.h"

using number = @NUMBER@;
using nav_msgs::msg::Odometry;
using trajectory_msgs::msg::MultiDOFJointTrajectoryPoint;
#if @COMMANDS_ATTITUDE@
using Command = mavros_msgs::msg::AttitudeTarget;
#else
using Command = geometry_msgs::msg::WrenchStamped;
#endif

class ControllerNode : public rclcpp::Node
{
public:
    ControllerNode() : Node("@NAME@")
    {
        @NAME@_init(&controller_);
        /* Age at which the odometry is too old to fly with, s. */
        max_age_ = declare_parameter("max_age", 0.2);
#if @COMMANDS_ATTITUDE@
        /* Weight of the vehicle in N, and the normalised thrust at which it hovers. */
        weight_ = declare_parameter("weight", @WEIGHT@);
        hover_thrust_ = declare_parameter("hover_thrust", 0.5);
#endif
        publisher_ = create_publisher<Command>("command", rclcpp::QoS(1));
        odometry_ = create_subscription<Odometry>(
            "odometry", rclcpp::SensorDataQoS(), [this](Odometry::ConstSharedPtr message) { read_odometry(*message); });
        reference_ = create_subscription<MultiDOFJointTrajectoryPoint>(
            "reference", rclcpp::QoS(1),
            [this](MultiDOFJointTrajectoryPoint::ConstSharedPtr message) { read_reference(*message); });
        /* The clock of the node follows a simulator if use_sim_time is set. */
        timer_ = rclcpp::create_timer(this, get_clock(), std::chrono::microseconds(@MICROSECONDS@), [this]() { step(); });
    }

private:
    template <class Quaternion> static number yaw_of(const Quaternion &q)
    {
        return number(std::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z)));
    }

    void read_odometry(const Odometry &message)
    {
        const auto &p = message.pose.pose.position;
        const auto &q = message.pose.pose.orientation;
        const auto &v = message.twist.twist.linear;
        const auto &w = message.twist.twist.angular;
        if (!std::isfinite(p.x + p.y + p.z + q.w + q.x + q.y + q.z + v.x + v.y + v.z + w.x + w.y + w.z))
            return;
        auto &measurement = inputs_.@MEASUREMENT@;
        measurement.x = number(p.x);
        measurement.y = number(p.y);
        measurement.z = number(p.z);
        measurement.roll = number(std::atan2(2.0 * (q.w * q.x + q.y * q.z), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)));
        measurement.pitch = number(std::asin(std::fmax(-1.0, std::fmin(1.0, 2.0 * (q.w * q.y - q.z * q.x)))));
        measurement.yaw = yaw_of(q);
        /* Rotation of the velocity to the world frame: v + 2 w (u × v) + 2 u × (u × v) with q = (w, u). */
        const double c_x = q.y * v.z - q.z * v.y, c_y = q.z * v.x - q.x * v.z, c_z = q.x * v.y - q.y * v.x;
        measurement.v_x = number(v.x + 2.0 * (q.w * c_x + q.y * c_z - q.z * c_y));
        measurement.v_y = number(v.y + 2.0 * (q.w * c_y + q.z * c_x - q.x * c_z));
        measurement.v_z = number(v.z + 2.0 * (q.w * c_z + q.x * c_y - q.y * c_x));
        measurement.p = number(w.x);
        measurement.q = number(w.y);
        measurement.r = number(w.z);
        measured_at_ = now();
        if (!measured_ && !has_reference_)
            hover();
        measured_ = true;
    }

    /* Set the reference to hover at the measured position and yaw. */
    void hover()
    {
        const auto &measurement = inputs_.@MEASUREMENT@;
        inputs_.reference = {};
        inputs_.reference.x = measurement.x;
        inputs_.reference.y = measurement.y;
        inputs_.reference.z = measurement.z;
        inputs_.reference.yaw = measurement.yaw;
    }

    void read_reference(const MultiDOFJointTrajectoryPoint &message)
    {
        if (message.transforms.empty())
            return;
        auto &reference = inputs_.reference;
        reference = {};
        reference.x = number(message.transforms[0].translation.x);
        reference.y = number(message.transforms[0].translation.y);
        reference.z = number(message.transforms[0].translation.z);
        reference.yaw = yaw_of(message.transforms[0].rotation);
        if (!message.velocities.empty()) {
            reference.v_x = number(message.velocities[0].linear.x);
            reference.v_y = number(message.velocities[0].linear.y);
            reference.v_z = number(message.velocities[0].linear.z);
            reference.yaw_rate = number(message.velocities[0].angular.z);
        }
        if (!message.accelerations.empty()) {
            reference.a_x = number(message.accelerations[0].linear.x);
            reference.a_y = number(message.accelerations[0].linear.y);
            reference.a_z = number(message.accelerations[0].linear.z);
        }
        has_reference_ = true;
    }

    void step()
    {
        if (!measured_ || (now() - measured_at_).seconds() > max_age_) {
            /* Publish no command, and reset the controller. It starts again when odometry arrives. */
            @NAME@_init(&controller_);
            measured_ = false;
            return;
        }
#if @HAS_REFERENCE@
        @NAME@_reference(number(controller_.step * @NAME_UPPER@_PERIOD), &inputs_);
#endif
        @NAME@_step(&controller_, &@NAME@_default_parameters, &inputs_, &outputs_);
        Command command;
        command.header.stamp = now();
        command.header.frame_id = "base_link";
#if @COMMANDS_ATTITUDE@
        const auto &target = outputs_.attitude_target;
        const double c_r = std::cos(0.5 * target.roll), s_r = std::sin(0.5 * target.roll);
        const double c_p = std::cos(0.5 * target.pitch), s_p = std::sin(0.5 * target.pitch);
        const double c_y = std::cos(0.5 * target.yaw), s_y = std::sin(0.5 * target.yaw);
        command.type_mask = Command::IGNORE_ROLL_RATE | Command::IGNORE_PITCH_RATE | Command::IGNORE_YAW_RATE;
        command.orientation.w = c_y * c_p * c_r + s_y * s_p * s_r;
        command.orientation.x = c_y * c_p * s_r - s_y * s_p * c_r;
        command.orientation.y = c_y * s_p * c_r + s_y * c_p * s_r;
        command.orientation.z = s_y * c_p * c_r - c_y * s_p * s_r;
        command.thrust = float(hover_thrust_ * target.thrust / weight_);
#else
        command.wrench.force.z = outputs_.wrench.thrust;
        command.wrench.torque.x = outputs_.wrench.tau_x;
        command.wrench.torque.y = outputs_.wrench.tau_y;
        command.wrench.torque.z = outputs_.wrench.tau_z;
#endif
        publisher_->publish(command);
    }

    @NAME@_t controller_{};
    @NAME@_inputs_t inputs_{};
    @NAME@_outputs_t outputs_{};
    rclcpp::Time measured_at_;
    bool measured_ = false;
    bool has_reference_ = false;
    double max_age_ = 0.0;
#if @COMMANDS_ATTITUDE@
    double weight_ = 0.0;
    double hover_thrust_ = 0.0;
#endif
    rclcpp::Publisher<Command>::SharedPtr publisher_;
    rclcpp::Subscription<Odometry>::SharedPtr odometry_;
    rclcpp::Subscription<MultiDOFJointTrajectoryPoint>::SharedPtr reference_;
    rclcpp::TimerBase::SharedPtr timer_;
};

int main(int argc, char **argv)
{
    rclcpp::init(argc, argv);
    rclcpp::spin(std::make_shared<ControllerNode>());
    rclcpp::shutdown();
    return 0;
}
