"""An Iridium SBD modem: a report of the boat each ten minutes, and a few orders back."""
