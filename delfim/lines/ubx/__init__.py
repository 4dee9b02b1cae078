"""UBX, the binary protocol of u-blox receivers: bytes in, values in SI units out; no ports and no clock (docs/rtk.md)."""
