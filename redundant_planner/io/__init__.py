"""Bytes and files: messages, bags, robots, scenarios. No rclpy."""
