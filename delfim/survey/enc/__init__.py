"""Charts of the water as offices publish them (S-57): what is dangerous in them for one boat, and where she may be."""
