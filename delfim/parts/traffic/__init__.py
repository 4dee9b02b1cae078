"""Other vessels: heard, tracked, told of (docs/traffic.md). Their data, part of the state, is in `delfim.vehicle.target`."""
