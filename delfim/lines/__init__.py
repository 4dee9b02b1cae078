"""Lines to devices: serial ports, network lines, GPIO pins, and RTCM on them."""
