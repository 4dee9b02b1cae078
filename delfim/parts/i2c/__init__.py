"""Sensors on the computer's I2C buses: BNO085, INA226, BMP390 (docs/i2c.md)."""
