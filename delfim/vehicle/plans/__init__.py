"""Plans: missions, fence, zones, the way round them and the driven track. Checked in slices before they count."""
