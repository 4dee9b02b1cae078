"""The boat's own CAN nodes, those of the thesis: navigation and motors."""
