"""Pictures and numbers from a recorded run. No rclpy here."""
