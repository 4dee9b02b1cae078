"""From soundings to a chart: read, reduced, cleaned, laid into cells, compared where lines cross, written for others."""
