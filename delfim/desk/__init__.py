"""What `delfim sensors` hears and says of a boat's sensors."""
