"""ROS 2 without ROS: its messages over Zenoh as rmw_zenoh puts them there. See docs/ros2.md."""
