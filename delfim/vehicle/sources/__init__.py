"""Navigation inputs, a file each, named as in `navigation.sources` of the vehicle's file."""
