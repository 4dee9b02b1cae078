"""Finding out what a boat is: its hull, motors and compass, fitted ashore to a record of how it moved. Needs numpy."""
