"""The boat's energy: what the batteries hold, what the way home takes, and how far the boat can go (docs/energy.md)."""
