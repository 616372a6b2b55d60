"""ROS 2 nodes of tms_fit, the only modules of the package that import rclpy."""
