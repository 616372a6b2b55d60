"""The nodes of tms_sim, the only modules here that know rclpy."""
