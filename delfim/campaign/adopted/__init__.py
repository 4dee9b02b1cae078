"""Runs of a campaign that are whole adoptions: a trial of a drawn boat, its fit, its gains, and how she sails with them."""
