"""The console's link of the vehicle: MAVLink 2 over UDP. All messages: docs/mavlink.md."""
