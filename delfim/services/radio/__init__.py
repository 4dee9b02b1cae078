"""The radio link: SLIP with header compression, its supervisor slipd, and several boats on one frequency."""
