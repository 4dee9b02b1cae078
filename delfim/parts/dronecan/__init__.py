"""DroneCAN: motors, receivers, compasses and batteries; numbers for devices that come without one."""
