"""The pages of a console: who is let in, each of them, and what they need to be kept by a browser."""
