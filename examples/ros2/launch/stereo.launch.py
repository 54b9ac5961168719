# SPDX-License-Identifier: Apache-2.0
"""ros2 launch ft_ros2 stereo.launch.py camera:=/stereo imu:=/imu/data use_imu:=true"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "camera": ("/stereo", "namespace of left and right: image_rect and camera_info"),
    "imu": ("/imu/data", "topic of the IMU"),
    "use_imu": ("false", "whether there is one"),
    "device": ("host", "host, or cuda in a build with USE_CUDA"),
    "base_frame": ("base_link", "the frame whose pose is published"),
    "loops": ("false", "whether places seen before correct map to odom"),
    "image_transport": ("raw", "raw, compressed ..."),
}


def generate_launch_description():
    value = LaunchConfiguration
    topics = ["left/image_rect", "right/image_rect", "left/camera_info", "right/camera_info"]
    node = Node(
        package="ft_ros2",
        executable="stereo_node",
        output="screen",
        parameters=[{
            "use_imu": ParameterValue(value("use_imu"), value_type=bool),
            "loops": ParameterValue(value("loops"), value_type=bool),
            "device": value("device"),
            "base_frame": value("base_frame"),
            "image_transport": value("image_transport"),
        }],
        remappings=[(topic, [value("camera"), "/" + topic]) for topic in topics] + [("imu", value("imu"))],
    )
    arguments = [DeclareLaunchArgument(name, default_value=default, description=text)
                 for name, (default, text) in ARGUMENTS.items()]
    return LaunchDescription(arguments + [node])
