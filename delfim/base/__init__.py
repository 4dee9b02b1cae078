"""What every room stands on: errors, clocks, frames, angles, tables of TOML, bounded input, work in slices."""
