"""The boat's image: its file, and the two slots that it is kept in."""
