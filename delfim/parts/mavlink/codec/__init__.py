"""What the messages say, for both ends of the console's link."""
