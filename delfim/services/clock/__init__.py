"""The computer's clock: set by the boat's sources of time, and sent on the bus by timed."""
