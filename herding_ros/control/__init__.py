"""What decides: optimal control, space mapping and the receding horizon (no ROS)."""
