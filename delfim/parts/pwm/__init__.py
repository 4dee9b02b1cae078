"""Motors and servos that are driven by pulses."""
