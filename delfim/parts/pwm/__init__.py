"""Motors and servos that are told by pulses."""
