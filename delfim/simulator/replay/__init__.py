"""Replay of a day at sea through the real loop, and playback of a black box onto a bus."""
