"""From forces to the commands of the thrusters, and the last gate before them (docs/propulsion.md)."""
