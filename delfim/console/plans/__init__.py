"""Plans: as the page has them, checked, tried, kept in files."""
