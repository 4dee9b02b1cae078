"""Radio controls on serial lines: the channels of SBUS and CRSF."""
