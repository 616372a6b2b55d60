"""The nodes of tms_fit, the only modules here that know rclpy."""
