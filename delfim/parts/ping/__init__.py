"""Echo sounders that speak Blue Robotics' Ping protocol."""
