"""Input that is bounded before it is used: files, JSON and TOML, private keys, and what a line may say in a second."""
