"""Sensors on the computer's I2C buses: BNO085, ICM-20948, INA226, BMP390 (docs/i2c.md)."""
