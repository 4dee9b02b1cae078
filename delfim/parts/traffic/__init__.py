"""Other vessels: received, tracked and reported (docs/traffic.md). Their data, part of the state, is in
`delfim.vehicle.target`."""
