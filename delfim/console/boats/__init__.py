"""The boats that a console knows: their state, ways to them, orders, thrust by hand, plans that go up and down."""
