"""What consoles say to the boat, and its answers."""
