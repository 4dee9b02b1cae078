"""The computer's clock: kept by the sources of time of the boat, and told on the bus by timed."""
