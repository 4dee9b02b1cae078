"""Lines to devices: serial ports, network lines, GPIO pins; NMEA 0183, UBX and RTCM on them."""
