"""The boat without the boat: a model of the hull, the other CAN nodes, a guest computer, lock-step and live simulation."""
