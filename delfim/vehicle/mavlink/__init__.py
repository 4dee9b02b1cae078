"""The console's link of the vehicle: MAVLink 2 over UDP. What is said and understood: docs/mavlink.md."""
