"""The hand-set of a radio control as an operator of the boat."""
