"""The trial on the water: the motors are found and proven, then the hull is tried, within bounds that the boat itself keeps."""
