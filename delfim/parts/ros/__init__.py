"""The boat in ROS 2, over Zenoh."""
